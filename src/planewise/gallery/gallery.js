"use strict";
(() => {
  const PER_PAGE = 48;
  const SVG = "http://www.w3.org/2000/svg";
  const at = (id) => document.getElementById(id);
  const settings = JSON.parse(at("settings").textContent);

  // Records are read at once; pictures, by far the larger part, block by block when they are shown.
  const pictureBlocks = [...document.querySelectorAll("script.pictures")];
  const frames = [...document.querySelectorAll("script.records")].flatMap((each, block) =>
    JSON.parse(each.textContent).map((record, place) => {
      const saved = Number.isFinite(record.curve[0]) ? record.curve[0] - record.information : NaN;
      return { ...record, block, place, saved, rate: saved / record.readings };
    }));
  const unpacked = new Map();
  const KEPT = 8;

  function picture(frame) {
    if (!unpacked.has(frame.block)) {
      if (unpacked.size >= KEPT) unpacked.delete(unpacked.keys().next().value);
      unpacked.set(frame.block, JSON.parse(pictureBlocks[frame.block].textContent));
    }
    return unpacked.get(frame.block)[frame.place];
  }

  const state = { page: 0, descending: false, chosen: frames };
  const opened = new Set(); // numbers of frames whose details are shown

  const whole = (value) => Math.round(value).toLocaleString("en");
  const fixed = (value, digits) => value === null ? "–" : value.toFixed(digits);
  const size = (value, unit) => // three digits, however small
    value === null ? "–" : `${value < 100 ? value.toPrecision(3) : whole(value)} ${unit}`;
  const planes = (count) => count === 1 ? "1 plane" : `${whole(count)} planes`;
  const noun = frames.length === 1 ? "frame" : "frames";

  function make(tag, attributes = {}, ...children) {
    const [space, name] = tag.startsWith("svg:") ? [SVG, tag.slice(4)] : ["http://www.w3.org/1999/xhtml", tag];
    const node = document.createElementNS(space, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    node.append(...children); // strings become text, never markup
    return node;
  }

  // Sorting and filtering

  const values = {
    number: (frame) => frame.number,
    planes: (frame) => frame.failed === undefined ? frame.planes.length : -1,
    saved: (frame) => frame.saved,
    rate: (frame) => frame.rate,
    failed: (frame) => frame.failed === undefined ? 1 : 0,
  };

  function bound(id, otherwise) {
    const value = at(id).valueAsNumber;
    return Number.isNaN(value) ? otherwise : value;
  }

  // One spelling of letters with marks: macOS writes these apart.
  const folded = (text) => text.normalize("NFC").toLowerCase();

  function wanted() {
    const name = folded(at("name").value);
    const [fewest, most] = [bound("fewest", -Infinity), bound("most", Infinity)];
    const [least, largest] = [bound("least", -Infinity), bound("largest", Infinity)];
    const limited = [fewest, most, least, largest].some(Number.isFinite);
    const status = at("status").value;
    return (frame) => {
      const failed = frame.failed !== undefined;
      if (name && !folded(frame.id).includes(name)) return false;
      if (status === "failed" && !failed || (status === "done" || status === "none") && failed) return false;
      if (status === "none" && frame.planes.length) return false;
      if (failed) return !limited;
      const count = frame.planes.length;
      return count >= fewest && count <= most && !(frame.saved < least) && !(frame.saved > largest);
    };
  }

  function choose() {
    const key = at("sort").value;
    const value = values[key];
    at("direction").disabled = key === "failed"; // failures are first, or nobody would find them
    const sign = state.descending && key !== "failed" ? -1 : 1;
    const end = (number) => Number.isNaN(number) ? Infinity : sign * number; // what has none is last
    state.chosen = frames.filter(wanted()).sort((a, b) => {
      const [left, right] = [end(value(a)), end(value(b))];
      return left === right ? a.number - b.number : left < right ? -1 : 1;
    });
    state.page = 0;
    show();
  }

  // Cards

  function card(frame) {
    const open = opened.has(frame.number);
    const item = make("li", { class: open ? "card open" : "card" });
    const text = make("div", { class: "text" }, make("h3", {}, frame.id));
    if (frame.failed !== undefined) {
      item.classList.add("failure");
      item.append(make("div", { class: "blank" }, "no result"), text);
      text.append(make("p", { class: "failed" }, make("b", {}, "✗ Failed: "), frame.failed));
      return item;
    }
    const data = picture(frame);
    const over = frame.over ? ` over ${frame.over}` : ", drawn alone";
    item.append(data
      ? make("img", { src: `data:image/webp;base64,${data}`, alt: `${planes(frame.planes.length)} of ${frame.id}${over}`, decoding: "async" })
      : make("div", { class: "blank" }, "no picture"), text);
    text.append(numbers(frame));
    if (frame.note) text.append(make("p", { class: "quiet" }, frame.note));
    if (frame.alone) text.append(make("p", { class: "quiet" }, `Planes without the frame: ${frame.alone}`));
    const detail = make("div", { class: "detail", id: `detail-${frame.number}` });
    const button = make("button", { type: "button", "aria-controls": detail.id });
    const reveal = () => {
      const now = opened.has(frame.number);
      item.classList.toggle("open", now);
      detail.hidden = !now;
      button.setAttribute("aria-expanded", now);
      button.replaceChildren(now ? "Hide details" : "Details", make("span", { class: "unseen" }, ` of ${frame.id}`));
      if (now && !detail.childElementCount) detail.append(curve(frame), table(frame));
    };
    button.addEventListener("click", () => {
      if (!opened.delete(frame.number)) opened.add(frame.number);
      reveal();
    });
    reveal();
    text.append(button);
    item.append(detail);
    return item;
  }

  function numbers(frame) {
    const line = make("p", { class: "numbers" }, make("b", {}, planes(frame.planes.length)));
    if (frame.planes.length) {
      line.append(" · ", ...(Number.isNaN(frame.saved) ? ["nats saved not known"] :
        [make("b", {}, whole(frame.saved)), ` nats saved, ${frame.rate.toFixed(2)} a reading`]));
    }
    return line;
  }

  function table(frame) {
    const titles = ["Plane", "Nats", "Readings", "Share", "Normal x", "Normal y", "Normal z", "Distance", "Rms", "Area"];
    const head = make("tr", {}, ...titles.map((title) => make("th", { scope: "col" }, title)));
    const rows = frame.planes.map(([x, y, z, distance, information, readings, rms, area], index) => {
      const colour = settings.colours[index % settings.colours.length];
      const swatch = make("svg:svg", { class: "swatch", viewBox: "0 0 8 8", "aria-hidden": "true" },
        make("svg:rect", { width: 8, height: 8, rx: 1.5, fill: colour }));
      return make("tr", {},
        make("th", { scope: "row" }, swatch, String(index + 1)),
        ...[
          whole(information), whole(readings), `${(100 * readings / frame.readings).toFixed(1)} %`,
          fixed(x, 3), fixed(y, 3), fixed(z, 3), `${fixed(distance, 3)} m`,
          size(rms === null ? null : 1000 * rms, "mm"), size(area, "m²"),
        ].map((text) => make("td", {}, text)));
    });
    // Apart, for a name may turn the direction of what follows it.
    const caption = make("span", {}, "Planes of ", make("bdi", {}, frame.id), ", best first; nats against outliers");
    const all = make("table", {},
      make("caption", {}, caption), make("thead", {}, head), make("tbody", {}, ...rows));
    return make("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": `Planes of ${frame.id}` }, all);
  }

  function roundValues(low, high) {
    const most = (high - low) / 3 || 1; // so that there are three at least
    const power = 10 ** Math.floor(Math.log10(most));
    const step = power * ([5, 2].find((each) => each * power <= most) || 1);
    const first = Math.ceil(low / step);
    const count = Math.floor(high / step) - first + 1;
    return count > 0 ? Array.from({ length: count }, (_, k) => (first + k) * step) : [low];
  }

  // In which numbers as large as this are short enough for the axis.
  function units(largest) {
    return largest >= 2e7 ? [1e6, "million nats"] : largest >= 2e4 ? [1e3, "thousand nats"] : [1, "nats"];
  }

  function curve(frame) {
    const [width, height, left, right, top, bottom] = [400, 220, 66, 10, 24, 34];
    const values = frame.curve;
    const chosen = Math.min(frame.planes.length, values.length - 1);
    const known = values.filter((each) => each !== null);
    if (!known.length || values[chosen] === null) return make("p", { class: "quiet curve" }, "No curve is known.");
    const [low, high] = [Math.min(...known), Math.max(...known)];
    const last = Math.max(values.length - 1, 1);
    const x = (number) => left + (width - left - right) * number / last;
    const y = (value) => top + (height - top - bottom) * (high > low ? (high - value) / (high - low) : 0.5);
    const label = `Information against the number of planes: ${whole(known[0])} nats with none, ` +
      `${whole(values[chosen])} with ${chosen}`;
    const picture = make("svg:svg", { class: "curve", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label });
    const line = (kind, x1, y1, x2, y2) => make("svg:line", { class: kind, x1, y1, x2, y2 });
    const word = (text, px, py, anchor, kind = "") =>
      make("svg:text", { x: px, y: py, "text-anchor": anchor, class: kind }, text);
    const levels = roundValues(low, high);
    const [unit, name] = units(Math.max(Math.abs(low), Math.abs(high)));
    const step = levels.length > 1 ? levels[1] - levels[0] : Math.max(1, unit / 10);
    const digits = Math.max(0, -Math.floor(Math.log10(step / unit) + 1e-9));
    const form = { minimumFractionDigits: digits, maximumFractionDigits: digits };
    for (const value of levels) {
      picture.append(line("grid", left, y(value), width - right, y(value)),
        word((value / unit).toLocaleString("en", form), left - 8, y(value) + 4, "end"));
    }
    const spots = [...values.entries()].filter((each) => each[1] !== null);
    const every = Math.max(1, Math.ceil(last / 10));
    for (let number = 0; number < values.length; number += every) {
      picture.append(word(String(number), x(number), height - bottom + 16, "middle"));
    }
    picture.append(word(name, 2, 12, "start"), word("planes", width - right, height - 4, "end"),
      line("mark", x(chosen), top, x(chosen), height - bottom),
      make("svg:polyline", { class: "line", points: spots.map(([number, value]) => `${x(number)},${y(value)}`).join(" ") }),
      ...spots.map(([number, value]) => make("svg:circle", { class: "dot", cx: x(number), cy: y(value), r: 2.2 })),
      make("svg:circle", { class: "chosen", cx: x(chosen), cy: y(values[chosen]), r: 5 }));
    const side = x(chosen) > width / 2 ? "end" : "start";
    picture.append(word(`${planes(chosen)}`, x(chosen) + (side === "end" ? -7 : 7), top + 10, side, "word"));
    return picture;
  }

  // Pages

  function show() {
    const pages = Math.max(1, Math.ceil(state.chosen.length / PER_PAGE));
    state.page = Math.min(Math.max(state.page, 0), pages - 1);
    const first = state.page * PER_PAGE;
    const shown = state.chosen.slice(first, first + PER_PAGE);
    at("frames").replaceChildren(...shown.map(card));
    const some = state.chosen.length === frames.length ? "" : ` of ${whole(frames.length)}`;
    const range = pages > 1 ? `; these are ${whole(first + 1)} to ${whole(first + shown.length)}` : "";
    at("count").textContent = state.chosen.length
      ? `${whole(state.chosen.length)}${some} ${noun}${range}.`
      : "No frame fits; widen the filters or reset them.";
    for (const pager of document.querySelectorAll(".pager")) {
      pager.hidden = pages === 1;
      pager.querySelector(".page").textContent = `Page ${state.page + 1} of ${pages}`;
      for (const button of pager.querySelectorAll("button")) {
        const to = state.page + Number(button.dataset.step);
        button.disabled = to < 0 || to >= pages;
      }
    }
  }

  function turn(button) {
    const above = button.closest(".pager").compareDocumentPosition(at("frames")) & Node.DOCUMENT_POSITION_FOLLOWING;
    state.page += Number(button.dataset.step);
    show();
    if (!above) at("results").scrollIntoView();
    if (!above || button.disabled) at("results").focus({ preventScroll: true });
  }

  function point(descending) {
    state.descending = descending;
    at("direction").setAttribute("aria-pressed", descending);
  }

  at("controls").addEventListener("submit", (event) => event.preventDefault());
  at("controls").addEventListener("input", choose);
  at("controls").addEventListener("reset", () => {
    point(false);
    setTimeout(choose); // when the fields have their first values again
  });
  at("direction").addEventListener("click", () => {
    point(!state.descending);
    choose();
  });
  for (const button of document.querySelectorAll(".pager button")) {
    button.addEventListener("click", () => turn(button));
  }

  const failed = frames.filter((frame) => frame.failed !== undefined).length;
  const found = frames.reduce((sum, frame) => sum + frame.planes.length, 0);
  at("totals").textContent = `${whole(frames.length)} ${noun}, ${planes(found)}, ` +
    `${failed ? `${whole(failed)} failed` : "none failed"}`;
  choose();
})();
