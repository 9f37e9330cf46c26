/* Pictures that zoom and say their numbers: drawn by BokehJS from the numbers that stand beside each picture,
   once somebody asks. Paper keeps the still picture. */
"use strict";
(() => {
  const DASHES = { "-": "solid", "--": "dashed", "-.": "dashdot", ":": "dotted" };
  const MARKERS = {
    o: "circle", ".": "circle", s: "square", "^": "triangle", v: "inverted_triangle", "*": "star",
    x: "x", X: "x", D: "diamond", "<": "triangle", ">": "triangle", "+": "cross",
  };
  const NARROWEST = 290; // of a panel, in pixels
  const INK = "#010203";
  const RED = "#d55e00";
  const MAP = ["#ffe945", "#d6c05c", "#aea371", "#8a8678", "#6b6d73", "#4a566d", "#213f6e", "#00224e"];

  /** BokehJS, which stands in the page as text until the first picture needs it. */
  const library = () => {
    for (const text of document.querySelectorAll('script[type="text/plain"][data-library]')) {
      const script = document.createElement("script");
      script.textContent = text.textContent;
      document.head.append(script);
      text.remove();
      window.Bokeh.set_log_level("warn");
    }
    return window.Bokeh;
  };

  const finite = (values) => values.map((v) => (v === null ? NaN : v));
  const colour = (c) => (c === INK ? "#1b1e23" : c);

  /** Lines, markers, bars and levels of a panel. */
  const drawSeries = (B, figure, panel, s) => {
    const [x, y] = [finite(s.x), finite(s.y)];
    const label = s.label ? { legend_label: s.label } : {};
    const line = { line_color: colour(s.colour), line_alpha: s.alpha ?? 1 };
    if (s.kind === "level" || s.kind === "instant") {
      const across = s.kind === "level";
      figure.add_layout(new B.Span({
        location: across ? y[0] : x[0], dimension: across ? "width" : "height", ...line,
        line_dash: DASHES[s.dash] ?? "solid", line_width: s.width,
      }));
      return [];
    }
    const name = x.map(() => s.label || panel.labels[1]);
    const data = { x, y, name };
    if (s.kind === "bar") {
      const source = new B.ColumnDataSource({ data: { ...data, width: s.widths } });
      const bottom = panel.log[1] ? panel.limits[1][0] : 0;
      return [figure.vbar({ field: "x" }, { field: "width" }, { field: "y" }, bottom,
        { source, fill_color: colour(s.colour), line_color: null, ...label })];
    }
    const source = new B.ColumnDataSource({ data });
    if (s.kind === "area") {
      figure.patch({ field: "x" }, { field: "y" },
        { source, fill_color: colour(s.colour), fill_alpha: 0.25, line_color: null, ...label });
      return [];
    }
    const found = [];
    if (s.dash) {
      found.push(figure.line({ field: "x" }, { field: "y" },
        { source, ...line, line_dash: DASHES[s.dash] ?? "solid", line_width: s.width, ...label }));
    } else if (!s.marker) {
      figure.line({ field: "x" }, { field: "y" }, { source, ...line, line_width: s.width });
    }
    if (s.marker) {
      found.push(figure.scatter({ field: "x" }, { field: "y" }, {
        source, marker: MARKERS[s.marker] ?? "circle", size: 1.4 * s.size, ...line,
        fill_color: s.hollow ? null : colour(s.colour), fill_alpha: s.alpha ?? 1, ...label,
      }));
    }
    return found;
  };

  /** Frames of a drive, each on its central half as in the still picture. */
  const drawCells = (B, figure, panel) => {
    const c = panel.cells;
    const names = new Map(panel.ticks[1]);
    const data = {
      left: [], right: [], top: [], bottom: [], colour: [], alpha: [],
      from: [], to: [], bin: [], margin: [], ratio: [], reason: [],
    };
    let [frame, step] = [0, 0];
    c.count.forEach((count, k) => {
      let [end, left] = [0, 0];
      for (let i = 0; i < count; i += 1, frame += 1) {
        if (left === 0) {
          left = c.steps[step + 1];
          step += 2;
        }
        end += c.steps[step - 2];
        left -= 1;
        const reason = Number(c.reason[frame]);
        const ratio = c.margin[frame] / c.threshold;
        const counted = reason <= 1;
        data.left.push((end - 0.75 * c.lengths[k]) * c.Ts);
        data.right.push((end - 0.25 * c.lengths[k]) * c.Ts);
        data.bottom.push(k - 0.48);
        data.top.push(k + 0.48);
        const shade = Math.min(MAP.length - 1, Math.floor(ratio * MAP.length));
        data.colour.push(!counted ? "#8a8f98" : ratio > 1 ? RED : MAP[Math.max(0, shade)]);
        data.alpha.push(reason === 0 ? 1 : 0.35);
        data.from.push((end - c.lengths[k]) * c.Ts);
        data.to.push(end * c.Ts);
        data.bin.push(names.get(k) ?? String(k));
        data.margin.push(counted ? c.margin[frame] : NaN);
        data.ratio.push(counted ? ratio : NaN);
        data.reason.push(c.reasons[reason]);
      }
    });
    const field = (name) => ({ field: name });
    const renderer = figure.quad(field("left"), field("right"), field("top"), field("bottom"), {
      source: new B.ColumnDataSource({ data }),
      fill_color: field("colour"), fill_alpha: field("alpha"), line_color: null,
    });
    figure.add_tools(new B.HoverTool({
      renderers: [renderer],
      tooltips: [["bin, rad/s", "@bin"], ["frame, s", "@from{0.00} to @to{0.00}"],
        ["margin", "@margin{0.000}"], ["of the threshold", "@ratio{0.000}"], ["judged", "@reason"]],
    }));
  };

  const drawPanel = (B, panel, ranges, width, height) => {
    const [xLimits, yLimits] = panel.limits;
    const shared = `${panel.shared}`;
    ranges[shared] ??= new B.Range1d({ start: xLimits[0], end: xLimits[1] });
    const figure = B.Plotting.figure({
      width, height, sizing_mode: "fixed",
      tools: ["pan", "wheel_zoom", "box_zoom", "reset", "save"], toolbar_location: "right",
      x_axis_type: panel.log[0] ? "log" : "linear", y_axis_type: panel.log[1] ? "log" : "linear",
      x_range: ranges[shared], y_range: new B.Range1d({ start: yLimits[0], end: yLimits[1] }),
      x_axis_label: panel.labels[0], y_axis_label: panel.labels[1],
      ...(panel.title ? { title: panel.title } : {}),
    });
    figure.toolbar.logo = null;
    figure.min_border_left = 75; // so that panels below each other line up
    [figure.below[0], figure.left[0]].forEach((axis, i) => {
      axis.axis_label_text_font_style = "normal";
      if (!panel.log[i]) axis.ticker.desired_num_ticks = (i ? height : width) < 400 ? 3 : 8;
      if (panel.ticks[i].length) {
        axis.ticker = new B.FixedTicker({ ticks: panel.ticks[i].map(([at]) => at) });
        axis.major_label_overrides = new Map(panel.ticks[i].map(([at, name]) => [at, name]));
      }
    });
    if (panel.cells) drawCells(B, figure, panel);
    const renderers = panel.series.flatMap((s) => drawSeries(B, figure, panel, s));
    if (renderers.length) {
      figure.add_tools(new B.HoverTool({
        renderers,
        tooltips: [["", "@name"], [panel.labels[0] || "x", "@x{0.0000a}"], ["value", "@y{0.0000a}"]],
      }));
    }
    if (panel.series.some((s) => s.label)) {
      const { legend } = figure;
      Object.assign(legend, {
        click_policy: "hide", label_text_font_size: "11px", border_line_color: null,
        ncols: Math.max(1, Math.floor(width / 190)), margin: 0, padding: 2,
      });
      figure.center = figure.center.filter((one) => one !== legend);
      figure.add_layout(legend, "above");
    }
    return figure;
  };

  /** All panels of a picture, in one document of Bokeh's: panels that share time or frequency move together. */
  const open = async (picture, panels) => {
    const B = library();
    const still = picture.querySelector("svg").getBoundingClientRect();
    const box = document.createElement("div");
    box.className = "zoom";
    picture.querySelector("svg").after(box);
    picture.classList.add("zoomed");
    const ranges = {};
    const rows = new Map();
    for (const panel of panels) {
      if (!rows.has(panel.row)) rows.set(panel.row, []);
      rows.get(panel.row).push(panel);
    }
    const lines = [...rows].sort(([a], [b]) => a - b).flatMap(([, row]) => {
      const most = Math.max(1, Math.floor(still.width / NARROWEST));
      const parts = [];
      for (let i = 0; i < row.length; i += most) parts.push(row.slice(i, i + most));
      return parts.map((part) => [part, Math.min(row.length, most)]);
    });
    const drawn = lines.map(([part, across]) => new B.Row({
      children: part.map((panel) => {
        const tall = Math.max(190, Math.round(panel.height * Math.max(still.height, 240)) + 100);
        return drawPanel(B, panel, ranges, Math.floor(still.width / across) - 4, tall);
      }),
    }));
    await B.Plotting.show(new B.Column({ children: drawn }), box);
  };

  for (const picture of document.querySelectorAll("figure")) {
    const numbers = picture.querySelector('script[type="application/json"]');
    if (!numbers) continue;
    const button = document.createElement("button");
    button.type = "button";
    button.className = "zoom-button";
    button.textContent = "Zoom and read numbers";
    button.setAttribute("aria-pressed", "false");
    let opened = null;
    button.addEventListener("click", () => {
      const show = button.getAttribute("aria-pressed") === "false";
      button.setAttribute("aria-pressed", String(show));
      button.textContent = show ? "Back to the still picture" : "Zoom and read numbers";
      if (opened === null) opened = open(picture, JSON.parse(numbers.textContent));
      else picture.classList.toggle("zoomed", show);
    });
    picture.querySelector("svg").before(button);
  }
})();
