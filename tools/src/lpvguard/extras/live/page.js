/* Asks the server what to show, draws it, and asks again. It asks when it has drawn, so it never falls behind. */
"use strict";
(() => {
  const EVERY_MS = 200;
  const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"];
  const at = (id) => document.getElementById(id);
  const pause = (ms) => new Promise((done) => setTimeout(done, ms));
  const numbers = (values) => values.map((v) => (v === null ? NaN : v));
  const B = window.Bokeh;
  B.set_log_level("error"); // it warns of pictures without data

  /** A picture with a source; its marks are drawn by `marks`. */
  const picture = async (id, caption, labels, columns, marks, options = {}) => {
    const frame = document.createElement("figure");
    frame.id = id;
    const place = document.createElement("div");
    place.className = "plot";
    const said = document.createElement("figcaption");
    said.textContent = caption;
    frame.append(said, place);
    at("pictures").append(frame);
    const plot = B.Plotting.figure({
      height: 230, sizing_mode: "stretch_width", output_backend: "canvas", tools: "pan,xwheel_zoom,box_zoom,reset",
      x_axis_label: labels[0], y_axis_label: labels[1], toolbar_location: "above",
      x_range: new B.Range1d({ start: 0, end: 1 }), ...options,
    });
    plot.toolbar.logo = null;
    const source = new B.ColumnDataSource({ data: Object.fromEntries(columns.map((c) => [c, []])) });
    marks(plot, source);
    await B.Plotting.show(plot, place);
    return { source, time: plot.x_range };
  };
  const level = (plot, location) => {
    plot.add_layout(new B.Span({ location, dimension: "width", line_color: "#a63f00", line_dash: "dashed" }));
  };
  const hover = (plot, tooltips, renderers) => plot.add_tools(new B.HoverTool({ tooltips, renderers }));
  /** Names marks below the picture, over none of them. */
  const legend = (plot, named) => plot.add_layout(new B.Legend({ orientation: "horizontal", padding: 2, margin: 2,
    border_line_color: null, label_text_font_size: "11px", spacing: 8,
    items: named.map(([label, mark]) => new B.LegendItem({ label: { value: label }, renderers: [mark] })) }), "below");
  const field = (name) => ({ field: name });

  /** Lines over time: names of the series and their labels. */
  const overTime = (id, caption, unit, names, threshold) => picture(id, caption, ["t [s]", unit], ["t", ...names],
    (plot, source) => {
      const lines = names.map((name, i) => {
        const line = plot.line(field("t"), field(name), { source, line_color: COLOURS[i], line_width: 1.5,
          line_dash: ["solid", "dashed", "dotted"][i % 3] });
        hover(plot, [["t", "@t{0.00} s"], [name, `@{${name}}{0.0000}`]], [line]);
        return [name, line];
      });
      if (lines.length > 1) legend(plot, lines);
      if (threshold) level(plot, threshold);
    });

  /** Where bins stand on a logarithmic axis; one at 0 rad/s stands below the lowest other. */
  const placesOf = (omega) => {
    const lowest = Math.min(...omega.filter((w) => w > 0));
    return omega.map((w) => (w > 0 ? w : lowest / 2));
  };

  const makeAll = async (what) => {
    const found = {};
    const log = () => ({ x_axis_type: "log", x_range: new B.DataRange1d() });
    const places = placesOf(what.omega);
    const ticks = [-3, -2, -1, 0, 1, 2, 3].flatMap((power) => [1, 2, 5].map((n) => n * 10 ** power))
      .filter((tick) => tick > 1.3 * places[0]);
    const axis = (plot) => {
      plot.xaxis.ticker = new B.FixedTicker({ ticks: [...places.slice(0, 1), ...ticks] });
      plot.xaxis.major_label_overrides = new Map([[places[0], String(+what.omega[0].toPrecision(2))]]);
      plot.xaxis.formatter = new B.BasicTickFormatter({ use_scientific: false });
    };
    const bins = ["place", "omega", "statistic", "largest", "margin", "evidence", "t"];
    found.margins = await picture("margins",
      `Margins over frequency: the newest frame of each bin, the largest of the window; dashed: the threshold ${
        what.threshold.toPrecision(3)} above which the model is refuted.`,
      ["frequency [rad/s]", "statistic"], bins, (plot, source) => {
        level(plot, what.threshold);
        axis(plot);
        const large = plot.scatter(field("place"), field("largest"), { source, marker: "dash", size: 16,
          line_color: COLOURS[1], line_width: 2 });
        const dots = plot.scatter(field("place"), field("statistic"), { source, marker: "circle", size: 8,
          fill_color: COLOURS[0], line_color: null });
        hover(plot, [["frequency", "@omega{0.000} rad/s"], ["statistic", "@statistic{0.000}"],
          ["t*", "@margin{0.000}"], ["largest", "@largest{0.000}"], ["judged at", "@t{0.00} s"]], [dots, large]);
        legend(plot, [["newest", dots], ["largest of the window", large]]);
      }, log());
    found.evidence = await picture("evidence",
      "Evidence: t* that a vehicle which did not respond at all would have read. Below 1 the frame could not object.",
      ["frequency [rad/s]", "evidence"], bins, (plot, source) => {
        level(plot, 1);
        axis(plot);
        const marks = plot.scatter(field("place"), field("evidence"), { source, marker: "triangle", size: 9,
          fill_color: COLOURS[2], line_color: null });
        hover(plot, [["frequency", "@omega{0.000} rad/s"], ["evidence", "@evidence{0.000}"],
          ["judged at", "@t{0.00} s"]], [marks]);
      }, log());
    found.energy = await picture("energy",
      `Energy test: the ratio, by the band that it is of; dashed: the threshold ${
        what.energy_threshold.toPrecision(3)}.`,
      ["t [s]", "ratio"], ["t", ...what.bands], (plot, source) => {
        level(plot, what.energy_threshold);
        legend(plot, what.bands.map((band, i) => {
          const marks = plot.scatter(field("t"), field(band), { source, size: 4, line_color: null,
            marker: ["circle", "square", "triangle", "diamond"][i % 4], fill_color: COLOURS[i] });
          hover(plot, [["t", "@t{0.00} s"], [band, `@{${band}}{0.000}`]], [marks]);
          return [band, marks];
        }));
      });
    found.change = await overTime("change",
      `Change test: gain, delay or bias over the largest of the drives that set the bounds; dashed: the threshold ${
        what.change_threshold.toPrecision(3)} above which the vehicle has changed.`,
      "ratio", ["change"], what.change_threshold);
    for (const name of what.inputs) {
      found[`input/${name}`] = await overTime(`input-${name}`, `Input ${name}.`, what.units[name], [name]);
    }
    for (const name of what.outputs) {
      const command = name === what.command_of ? ["command"] : [];
      found[`output/${name}`] = await overTime(`output-${name}`,
        `Response ${name}: measured, nominal model${command.length ? ", driver's command" : ""}.`,
        what.units[name], [name, `yhat/${name}`, ...command]);
    }
    found.speed = await overTime("speed", "Speed.", what.units[what.speed], [what.speed]);
    return found;
  };

  const draw = (what, pictures, view, [begin, end]) => {
    const series = Object.fromEntries(Object.entries(view.series).map(([k, v]) => [k, numbers(v)]));
    const omega = what.omega;
    const bins = Object.fromEntries(Object.entries(view.bins).map(([k, v]) => [k, numbers(v)]));
    const place = placesOf(omega);
    pictures.margins.source.data = { place, omega, ...bins };
    pictures.evidence.source.data = { place, omega, ...bins };
    pictures.energy.source.data = { t: series.t, ...Object.fromEntries(what.bands.map((band, i) =>
      [band, series.energy.map((v, k) => (series.band[k] === i ? v : NaN))])) };
    for (const [name, { source, time }] of Object.entries(pictures)) {
      if (name === "margins" || name === "evidence") continue;
      [time.start, time.end] = [begin, Math.max(end, begin + 1)];
      if (name === "energy") continue;
      const columns = Object.keys(source.data);
      source.data = Object.fromEntries(columns.map((c) => [c, series[c]]));
    }
  };

  const row = (cells, tag) => {
    const tr = document.createElement("tr");
    for (const cell of cells) {
      const td = document.createElement(tag);
      td.textContent = cell;
      tr.append(td);
    }
    return tr;
  };

  const tell = (view) => {
    const now = view.now;
    const verdict = now.verdict.replace("_", " ");
    at("state").className = now.silent ? "silent" : now.verdict;
    at("verdict").textContent = now.silent ? "source silent" : verdict;
    const said = [];
    if (now.silent) said.push(now.silent_s === null ? "nothing heard yet" :
      `source silent since ${now.silent_s.toFixed(0)} s; its last verdict: ${verdict}`);
    if (now.t !== null) said.push(`t = ${now.t.toFixed(1)} s`);
    said.push(`${view.n_alarms} alarms`);
    if (now.lost) said.push(`${now.lost} frames lost on the way here`);
    if (now.restarts) said.push(`the source's clock began anew ${now.restarts} times`);
    if (now.command_authentication) said.push(`GUARD_IN ${now.command_authentication.replaceAll("_", " ")}`);
    if (now.trouble) said.push(now.trouble);
    at("detail").textContent = said.join("; ");
    at("count").textContent = `(${view.n_alarms}${view.alarms.length < view.n_alarms ?
      `, the newest ${view.alarms.length} shown` : ""})`;
    at("alarms").replaceChildren(...view.alarms.slice().reverse().map((alarm) => {
      const li = document.createElement("li");
      li.textContent = `t = ${alarm.t_s.toFixed(2)} s, ${alarm.says}`;
      return li;
    }));
    const kinds = [...new Set(Object.values(view.can.messages).flatMap((m) => Object.keys(m)))];
    const live = (name) => (name in view.can.live ? (view.can.live[name] ? "live" : "not live") : "not needed");
    at("can").replaceChildren(row(["message", "state", ...kinds], "th"),
      ...Object.entries(view.can.messages).map(([name, m]) =>
        row([name, live(name), ...kinds.map((k) => m[k] ?? 0)], "td")));
    at("judged").textContent = `Judged frames by reason: ${Object.entries(view.frames)
      .filter(([, n]) => n).map(([k, n]) => `${k.replaceAll("_", " ")} ${n}`).join(", ") || "none yet"}.`;
  };

  let until = null; // null: now, else the end of the window that is shown
  const steer = (view) => {
    const [oldest, newest] = [view.now.oldest ?? 0, view.now.t ?? 0];
    const back = at("back");
    [back.min, back.max] = [oldest, newest];
    if (until === null) back.value = newest;
    const end = until ?? newest;
    const begin = Math.max(oldest, end - Number(at("span").value));
    at("at").textContent = `${begin.toFixed(1)} to ${end.toFixed(1)} s`;
    at("save").href = `drive.csv?from=${begin}&to=${end}`;
    at("pause").textContent = until === null ? "Pause" : "Go on";
    at("pause").setAttribute("aria-pressed", String(until !== null));
    return [begin, end];
  };

  const main = async () => {
    const what = await (await fetch("what")).json();
    at("title").textContent = what.title;
    at("source").textContent = `Vehicle ${what.vehicle}, source ${what.source}`;
    document.title = `lpvguard live: ${what.vehicle}`;
    const pictures = await makeAll(what);
    let newest = 0;
    at("pause").addEventListener("click", () => { until = until === null ? newest : null; });
    at("back").addEventListener("input", (event) => { until = Number(event.target.value); });
    at("steer").addEventListener("submit", (event) => event.preventDefault());
    for (let drawn = ""; ; await pause(EVERY_MS)) {
      try {
        const end = until === null ? "" : `&until=${until}`;
        const answer = await fetch(`view?span=${at("span").value}${end}`);
        if (!answer.ok) throw new Error(answer.statusText);
        const view = await answer.json();
        newest = view.now.t ?? 0;
        tell(view);
        const shows = steer(view);
        const shown = `${until ?? newest} ${at("span").value}`;
        if (shown !== drawn) draw(what, pictures, view, shows);
        drawn = shown;
        document.body.dataset.drawn = drawn;
      } catch (error) {
        at("state").className = "silent";
        at("verdict").textContent = "lpvguard live has ended or does not answer";
        at("detail").textContent = `asking again (${error.message})`;
        await pause(1000);
      }
    }
  };
  main();
})();
