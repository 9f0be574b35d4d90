// The page's charts, drawn as SVG: readings with pulls, and the error falling from fit to fit.

const SVG = "http://www.w3.org/2000/svg";
const TOP = 12;
const LEFT = 70;
const RIGHT = 12;
// heights of the panels of signals and pulls; a low window's chart stays beside its sliders, a
// narrow one above them
const TALL = { signals: 250, pulls: 150 };
const LOW = { signals: 150, pulls: 100 };
const SMALL = { signals: 104, pulls: 78 };
const [NARROW_PX, LOW_PX] = [480, 800];
// between the panels
const BETWEEN = 26;
// of a character of a slanting label, and the least width that one needs
const LABEL_PX = 5.2;
const LABEL_STEP = 15;
// least width of a reading: more than fit are scrolled through
const READING_PX = 9;
// least extent of the axis of pulls, and how far those of two fits stand apart
const LEAST_PULL = 3.2;
// an axis grows by this factor, again and again: mostly it stays while a slider moves
const STEP = 1.25;

function element(name, attributes, parent, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) {
    made.setAttribute(key, value);
  }
  if (text !== undefined) {
    made.textContent = text;
  }
  parent.append(made);
  return made;
}

// ---- axes ----

// round numbers from low to high, some five of them
function ticks(low, high) {
  const wide = (high - low) / 5;
  const power = 10 ** Math.floor(Math.log10(wide));
  const step = power * [1, 2, 5, 10].find((n) => n * power >= wide);
  const found = [];
  for (let n = Math.ceil(low / step); n * step <= high * (1 + 1e-9); n += 1) {
    found.push(n * step);
  }
  return found;
}

// 1, 2 and 5 of every power of ten
function logarithmicTicks(low, high) {
  const found = [];
  for (let power = Math.floor(Math.log10(low)); 10 ** power <= high; power += 1) {
    found.push(...[1, 2, 5].map((n) => n * 10 ** power));
  }
  return found.filter((value) => value >= low && value <= high);
}

// beside an axis is room for six characters
const short = (text) => (text.length > 6 ? Number(text).toExponential().replace("+", "") : text);
const numberText = (value) => short(`${Number(value.toPrecision(6))}`).replaceAll("-", "\u2212");

// at least `least`, grown by steps until all fit
function stepped(least, wanted) {
  const most = Math.max(least, ...wanted.filter(isFinite));
  if (most <= least || least <= 0) {
    return most;
  }
  return least * STEP ** Math.ceil(Math.log(most / least) / Math.log(STEP));
}

// lines across a chart, and what they mean, beside it
function grid(svg, values, y, left, right, axis = svg) {
  for (const value of values) {
    const at = y(value);
    element("line", { class: "grid", x1: left, x2: right, y1: at, y2: at }, svg);
    element("text", { class: "tick", x: LEFT - 6, y: at + 4, "text-anchor": "end" }, axis,
      numberText(value));
  }
}

function title(svg, text, x, y) {
  const turned = `translate(${x} ${y}) rotate(-90)`;
  element("text", { class: "title", "text-anchor": "middle", transform: turned }, svg, text);
}

function drawing(place, width, height, label) {
  const svg = element("svg", { width: width, height: height, role: "img", "aria-label": label },
    place);
  [svg.style.width, svg.style.height] = [`${width}px`, `${height}px`];
  return svg;
}

// a chart is drawn anew where its width changes
const widths = new ResizeObserver(function (entries) {
  for (const { target } of entries) {
    if (target.drawnWidth !== target.clientWidth && target.redraw) {
      target.redraw();
    }
  }
});

function keep(place, redraw) {
  place.drawnWidth = place.clientWidth;
  place.redraw = redraw;
  widths.observe(place);
}

// ---- readings, predictions and pulls ----

// all that stays while a slider moves, and how it is placed
function frame(place, chart, extents) {
  const { bottom, top, pull } = extents;
  const count = chart.signal.length;
  const end = chart.percent === null ? RIGHT : LEFT;
  const right = Math.max(place.clientWidth - LEFT - end, READING_PX * count);
  const size = window.innerHeight < LOW_PX ? LOW : TALL;
  const { signals, pulls } = place.clientWidth < NARROW_PX ? SMALL : size;
  const labels = chart.short;
  const longest = Math.max(...labels.map((label) => label.length));
  const pullsTop = TOP + signals + BETWEEN;
  const floor = pullsTop + pulls;
  const wide = right / count;
  const every = Math.ceil(LABEL_STEP / wide);
  // the axis stays where it is while many readings are scrolled through
  place.querySelector(".scrolled")?.remove();
  const scrolled = document.createElement("div");
  scrolled.className = "scrolled";
  place.append(scrolled);
  const height = floor + 24 + LABEL_PX * longest;
  // not as high as the other: labels of the first readings reach below it
  const axis = drawing(scrolled, LEFT, floor + 8, "axes of signals and pulls");
  const svg = drawing(scrolled, right + end, height,
    "readings with their errors, the model's predictions, and below them the pulls");
  const made = {
    svg: svg, wide: wide, scrolled: scrolled,
    x: (i) => wide * (i + 0.5),
    signal: (value) => TOP + (signals * (top - value)) / (top - bottom),
    pull: (value) => pullsTop + (pulls * (pull - value)) / (2 * pull),
  };
  for (const [sigmas, look] of [[2, "two"], [1, "one"]]) {
    element("rect", { class: `band ${look}`, x: 0, width: right,
      y: made.pull(sigmas), height: made.pull(-sigmas) - made.pull(sigmas) }, svg);
  }
  made.mark = element("rect", { class: "mark", y: TOP, height: floor - TOP, width: 0, x: 0 }, svg);
  grid(svg, ticks(bottom, top), made.signal, 0, right, axis);
  grid(svg, ticks(-pull, pull), made.pull, 0, right, axis);
  const zero = made.pull(0);
  element("line", { class: "zero", x1: 0, x2: right, y1: zero, y2: zero }, svg);
  const hasRoom = chart.unit && 7 * chart.unit.length + 60 < signals + BETWEEN;
  title(axis, hasRoom ? `signal (${chart.unit})` : "signal", 14, TOP + signals / 2);
  title(axis, "pull (σ)", 14, pullsTop + pulls / 2);
  if (chart.percent !== null) {
    for (const value of ticks(bottom / chart.percent, top / chart.percent)) {
      element("text", { class: "tick", x: right + 6, y: made.signal(value * chart.percent) + 4 },
        svg, numberText(value));
    }
    title(svg, "transmittance (%)", right + end - 6, TOP + signals / 2);
  }
  labels.forEach(function (label, i) {
    if (i % every === 0) {
      const place = `translate(${made.x(i) + 4} ${floor + 14}) rotate(-45)`;
      element("text", { class: "label", "text-anchor": "end", transform: place }, svg, label);
    }
  });
  const error = chart.signal.map(function (value, i) {
    const [low, high] = [value - chart.sigma[i], value + chart.sigma[i]].map(made.signal);
    return `M${made.x(i)} ${low}V${high}`;
  });
  const radius = Math.min(4, 0.2 * wide + 1);
  const dot = (used) => chart.signal.map(function (value, i) {
    const round = `a${radius} ${radius} 0 1 0 ${2 * radius} 0a${radius} ${radius} 0 1 0 `;
    return chart.use[i] === used
      ? `M${made.x(i) - radius} ${made.signal(value)}${round}${-2 * radius} 0` : "";
  });
  for (const kind of ["beside", "model"]) {
    made[kind] = {
      dashes: element("path", { class: `dashes ${kind}` }, svg),
      bars: element("path", { class: `bars ${kind} ${wide < 20 ? "thin" : ""}` }, svg),
    };
  }
  element("path", { class: "errors", d: error.join("") }, svg);
  element("path", { class: "dots", d: dot(true).join("") }, svg);
  element("path", { class: "dots unused", d: dot(false).join("") }, svg);
  return made;
}

function drawFit(made, kind, fit) {
  const half = Math.min(10, 0.45 * made.wide) * (kind === "model" ? 1 : 0.8);
  const bar = Math.min(24, 0.28 * made.wide);
  const aside = (kind === "model" ? 0.57 : -0.57) * bar;
  const zero = made.pull(0);
  const { dashes, bars } = made[kind];
  const [model, pull] = fit ? [fit.model, fit.pull] : [[], []];
  dashes.setAttribute("d", model.map((value, i) =>
    `M${made.x(i) - half} ${made.signal(value).toFixed(1)}h${2 * half}`).join(""));
  bars.setAttribute("d", pull.map((value, i) =>
    `M${made.x(i) + aside - bar / 2} ${zero}h${bar}V${made.pull(value).toFixed(1)}h${-bar}Z`
  ).join(""));
}

function legend(place, chart) {
  let line = place.querySelector(".legend");
  if (!line) {
    line = document.createElement("p");
    line.className = "legend";
    place.prepend(line);
  }
  const names = [["reading", "reading"]];
  if (chart.use.includes(false)) {
    names.push(["unused", "reading that is not used"]);
  }
  if (chart.model) {
    names.push(["model", "model"]);
  }
  if (chart.beside) {
    names.push(["beside", chart.beside.name]);
  }
  const key = JSON.stringify(names);
  if (line.key === key) {
    return;
  }
  line.key = key;
  line.replaceChildren(...names.map(function ([look, text]) {
    const made = document.createElement("span");
    made.className = look;
    made.textContent = text;
    return made;
  }));
}

export function drawReadings(place, chart) {
  legend(place, chart);
  const fits = [chart.model, chart.beside].filter(Boolean);
  const [models, pulls] = ["model", "pull"].map((name) => fits.flatMap((fit) => fit[name]));
  const above = chart.signal.map((value, i) => value + chart.sigma[i]);
  const below = chart.signal.map((value, i) => value - chart.sigma[i]);
  const extents = {
    top: stepped(1.08 * Math.max(0, ...above), models),
    bottom: -stepped(-1.08 * Math.min(0, ...below), models.map((value) => -value)),
    pull: stepped(LEAST_PULL, pulls.map((value) => 1.1 * Math.abs(value))),
  };
  const { model, beside, ...stays } = chart;
  const key = JSON.stringify([stays, extents, place.clientWidth]);
  if (place.key !== key) {
    place.key = key;
    place.made = frame(place, chart, extents);
    keep(place, () => drawReadings(place, place.chart));
  }
  place.chart = chart;
  drawFit(place.made, "model", model);
  drawFit(place.made, "beside", beside);
  place.dispatchEvent(new CustomEvent("drawn"));
}

// which reading is under the pointer
export function readingAt(place, clientX) {
  const { made, chart } = place;
  if (!made) {
    return null;
  }
  const i = Math.floor((clientX - made.svg.getBoundingClientRect().left) / made.wide);
  return i >= 0 && i < chart.signal.length ? i : null;
}

export function mark(place, i) {
  if (place.made && i !== null) {
    place.made.mark.setAttribute("x", place.made.x(i) - place.made.wide / 2);
    place.made.mark.setAttribute("width", place.made.wide);
  }
}

// bring a reading into sight where there are many
export function scrollTo(place, i) {
  if (!place.made) {
    return;
  }
  const { scrolled, x } = place.made;
  const seen = scrolled.clientWidth - LEFT;
  if (x(i) < scrolled.scrollLeft + 20 || x(i) > scrolled.scrollLeft + seen - 20) {
    scrolled.scrollLeft = x(i) - seen / 2;
  }
}

// ---- the error, fit by fit ----

const FALLING = 200;

// chi2 over its degrees of freedom; at 1 the model describes the readings
export function drawFalling(place, steps) {
  const heights = steps.map((step) => step.height).filter((height) => height > 0);
  place.replaceChildren();
  // one fit falls from nothing: the table below says it
  place.hidden = heights.length < 2;
  const width = place.clientWidth;
  const svg = drawing(place, width, TOP + FALLING + 26,
    "chi2 over degrees of freedom of every fit; at 1 the model describes the readings");
  const [low, high] = [Math.min(1, ...heights) / 1.5, 1.8 * Math.max(2, ...heights)];
  const right = width - RIGHT;
  const y = (value) => TOP + (FALLING * Math.log(high / value)) / Math.log(high / low);
  const wide = (right - LEFT) / Math.max(steps.length, 2);
  const x = (i) => LEFT + wide * (i + 0.5);
  grid(svg, logarithmicTicks(low, high), y, LEFT, right);
  element("line", { class: "goal", x1: LEFT, x2: right, y1: y(1), y2: y(1) }, svg);
  title(svg, "χ² / degrees of freedom", 14, TOP + FALLING / 2);
  let line = "";
  steps.forEach(function (step, i) {
    const most = Math.max(3, Math.floor(wide / 7));
    const name = step.name.length > most ? `${step.name.slice(0, most - 1)}…` : step.name;
    element("text", { class: "label", "text-anchor": "middle", x: x(i), y: TOP + FALLING + 18 },
      svg, name);
    if (step.height > 0) {
      line += line ? `H${x(i)}V${y(step.height)}` : `M${x(i)} ${y(step.height)}`;
      element("circle", { class: "dots", r: 5, cx: x(i), cy: y(step.height) }, svg);
      element("text", { class: "label", x: x(i) + 8, y: y(step.height) - 8 }, svg, step.text);
    }
  });
  svg.insertBefore(element("path", { class: "stairs", d: line }, svg),
    svg.querySelector("circle"));
  keep(place, () => drawFalling(place, steps));
}
