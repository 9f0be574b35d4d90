// What is written into the page, numbers as people type them, and the controls of parameters.
export const $ = (id) => document.getElementById(id);
export const idOf = (kind, name) => JSON.stringify({ kind: kind, name: name });

export function write(place, text) {
  if (place && place.textContent !== text) {
    place.textContent = text;
  }
}

// what has the focus keeps it, and what is open stays open
export function swap(id, html) {
  const place = $(id);
  if (place.given === html) {
    return;
  }
  const focus = place.contains(document.activeElement) ? document.activeElement : null;
  const at = focus && (focus.id || focus.dataset.key);
  const titleOf = (details) => details.querySelector("summary").textContent;
  const open = [...place.querySelectorAll("details[open]")].map(titleOf);
  place.given = html;
  place.innerHTML = html;
  for (const details of place.querySelectorAll("details")) {
    details.open = open.includes(titleOf(details));
  }
  if (at) {
    const same = [...place.querySelectorAll("[id], [data-key]")];
    (same.find((one) => one.id === at || one.dataset.key === at) || place).focus();
  }
}

const NUMBER = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i;
const THOUSANDS = /^[+-]?[1-9]\d{0,2}(,\d{3})+$/;

// [number, what is wrong with it]
export function read(text) {
  let plain = text.trim().replace("\u2212", "-");
  if (THOUSANDS.test(plain)) {
    const [whole, part] = [plain.replaceAll(",", ""), plain.replace(",", ".")];
    return [null, `${plain} can be read in two ways: write ${whole} or ${part}0`];
  }
  if (!plain.includes(".") && plain.split(",").length === 2) {
    plain = plain.replace(",", ".");
  }
  if (!NUMBER.test(plain) || !isFinite(Number(plain))) {
    const given = text.trim() ? `${text.trim()} is not a number` : "the field is empty";
    return [null, `${given}: write for example 0.3`];
  }
  return [Number(plain), ""];
}

export const shownNumber = (value) => String(Number(value.toPrecision(6)));

// where a value lies on its slider
const STEPS = Number(document.body.dataset.steps);

const coordinateOf = {
  linear: (value) => value,
  reciprocal: (value, scale) => 1 / (value + scale),
  logarithmic: (value, scale) => Math.log1p(value / scale),
};
const valueOf = {
  linear: (x) => x,
  reciprocal: (x, scale) => 1 / x - scale,
  logarithmic: (x, scale) => scale * Math.expm1(x),
};

export class Control {
  constructor(element) {
    const given = element.dataset;
    this.element = element;
    this.name = given.name;
    [this.minimum, this.maximum, this.scale] = [
      given.minimum, given.maximum, given.scale,
    ].map(Number);
    this.coordinate = given.coordinate;
    this.range = given.range;
    this.slider = $(idOf("slider", this.name));
    this.field = $(idOf("number", this.name));
    this.how = $(idOf("known", this.name));
    this.ends = [this.minimum, this.maximum].map((v) => this.coordinateOf(v));
    this.priors = element.querySelectorAll(".prior input");
    this.wrong = element.querySelector(".wrong");
  }

  coordinateOf(value) {
    return coordinateOf[this.coordinate](value, this.scale);
  }

  // values of neighbouring steps differ in four digits
  get slid() {
    const [low, high] = this.ends;
    const x = low + ((high - low) * Number(this.slider.value)) / STEPS;
    const value = valueOf[this.coordinate](x, this.scale);
    const inside = Math.min(Math.max(value, this.minimum), this.maximum);
    return Number(inside.toPrecision(4));
  }

  // whether somebody types there, and has not said that it is all
  static isTyped(field) {
    return document.activeElement === field && Boolean(field.dataset.typing);
  }

  show(value, force = false) {
    const [low, high] = this.ends;
    this.slider.value = Math.round((STEPS * (this.coordinateOf(value) - low)) / (high - low));
    this.slider.setAttribute("aria-valuetext", shownNumber(value));
    if (force || !Control.isTyped(this.field)) {
      this.field.value = shownNumber(value);
      this.refuse(this.field, "");
    }
  }

  // what is wrong with a field, in words below it
  refuse(field, problem) {
    field.setAttribute("aria-invalid", String(Boolean(problem)));
    field.dataset.problem = problem;
    delete field.dataset.typing;
    const all = [this.field, ...this.priors].map((each) => each.dataset.problem);
    write(this.wrong, all.filter(Boolean).join("; "));
  }
}
