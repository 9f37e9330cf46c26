/* What the page does beyond being read: the map answers to pointer and arrow keys, the index of drives sorts
   and searches. */
"use strict";
(() => {
  const map = document.getElementById("blind-map");
  const reading = document.getElementById("map-reading");
  const cells = map ? [...map.querySelectorAll("td[data-state]")] : [];
  const read = (cell) => {
    reading.textContent = cell.title;
    for (const other of cells) other.tabIndex = other === cell ? 0 : -1;
  };
  for (const cell of cells) {
    cell.tabIndex = cell === cells[0] ? 0 : -1;
    cell.setAttribute("aria-label", cell.title);
    cell.addEventListener("pointerenter", () => read(cell));
    cell.addEventListener("focus", () => read(cell));
    cell.addEventListener("keydown", (event) => {
      const row = cell.parentElement;
      const column = [...row.children].indexOf(cell);
      const to = {
        ArrowLeft: cell.previousElementSibling,
        ArrowRight: cell.nextElementSibling,
        ArrowUp: row.previousElementSibling && row.previousElementSibling.children[column],
        ArrowDown: row.nextElementSibling && row.nextElementSibling.children[column],
      }[event.key];
      if (to && to.dataset.state) {
        event.preventDefault();
        to.focus();
      }
    });
  }

  const index = document.getElementById("drive-index");
  if (!index) return;
  const body = index.tBodies[0];
  const value = (row, column) => {
    const cell = row.cells[column];
    return "value" in cell.dataset ? Number(cell.dataset.value) : cell.textContent;
  };
  const compare = (a, b) =>
    typeof a === "number" && typeof b === "number"
      ? a - b
      : typeof a === typeof b
        ? a.localeCompare(b, "en", { numeric: true })
        : typeof a === "number" ? 1 : -1;
  [...index.tHead.rows[0].cells].forEach((head, column) => {
    if (!head.dataset.sort) return;
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = head.textContent;
    button.title = "sort by this column";
    head.replaceChildren(button);
    button.addEventListener("click", () => {
      // Numbers begin with the largest, words with the first letter.
      const before = head.getAttribute("aria-sort");
      const descending = before ? before === "ascending" : head.dataset.sort === "number";
      for (const other of index.tHead.rows[0].cells) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", descending ? "descending" : "ascending");
      const sign = descending ? -1 : 1;
      body.append(...[...body.rows].sort((a, b) => sign * compare(value(a, column), value(b, column))));
    });
  });
  const search = document.createElement("input");
  search.type = "search";
  search.id = "drive-search";
  search.placeholder = "search: name, driver, part, test, verdict";
  search.setAttribute("aria-label", "search the drives");
  search.addEventListener("input", () => {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    for (const row of body.rows) {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every((word) => text.includes(word));
    }
  });
  document.getElementById("drive-tools").append(search);
})();
