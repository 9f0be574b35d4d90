// The page's behaviour: its controls, what they ask the server, and how the session is.
import { drawFalling, drawReadings, mark, readingAt, scrollTo } from "./charts.js";
import { $, Control, read, shownNumber, swap, write } from "./controls.js";
import { cellText, refuseCell, rows, showReadings } from "./table.js";

// between looks at the running job, and when there is none; an answer that takes longer is lost
const BUSY_MS = 300;
const IDLE_MS = 1500;
const PATIENCE_MS = 15000;
// what may be sent to the page, and what the server takes (base64 is a third longer)
const MOST_UPLOADED = 10e6;
// while a slider moves nothing is read out
const QUIET_MS = 600;

const controls = new Map(
  [...document.querySelectorAll(".control")].map((one) => [one.dataset.name, new Control(one)])
);
const boxes = new Map(
  [...document.querySelectorAll(".effect")].map((one) => [
    one.dataset.effect,
    { box: one.querySelector("input"), sizes: one.querySelector(".sizes") },
  ])
);
const follows = document.querySelector("#fit-scale input");

// ---- what the page knows ----

// the settings in full digits, of which the fields show six
let settings = null;
let numbers = { number: -1, settings_number: -1 };
let fileNumber = Number(document.body.dataset.file);
// files that were asked for here
const wanted = new Set();

function sent() {
  return { settings: settings, settings_number: numbers.settings_number };
}

function isEntered() {
  return !document.querySelector(":is(.typed, select)[aria-invalid=true]");
}

// numbers that belong to other values than those beside them are grey
let unanswered = false;
let pending = false;
function shade() {
  const wrong = !isEntered();
  const stale = unanswered || pending || wrong;
  document.body.classList.toggle("stale", stale);
  if (wrong) {
    write($("pending"), "These numbers are of other values: a field holds none that can be used.");
  } else if ($("slip").textContent === MEND_FIRST) {
    write($("slip"), "");
  }
}
const MEND_FIRST = "a field holds a value that cannot be used: mend it first";

// ---- what has changed, in words ----

// what was done here last, until it shows; values moved here since the controls were last set
let doing = "";
const moved = new Map();
const changes = { why: "", from: null, to: null, p: "", lost: "", timer: null };

function titleOf(name) {
  return controls.get(name)?.element.getAttribute("aria-label") || name;
}

// nothing changes without a word: who changed chi2, from what to what
function tellChange(chi2, p) {
  if (chi2 === "…") {
    return;
  }
  changes.from ??= chi2;
  [changes.to, changes.p] = [chi2, p];
  window.clearTimeout(changes.timer);
  changes.timer = window.setTimeout(writeChange, QUIET_MS);
}

function writeChange() {
  const { why, from, to, p, lost } = changes;
  if (doing) {
    changes.timer = window.setTimeout(writeChange, QUIET_MS); // it is told when it is done
    return;
  }
  if (from !== to || why) {
    const fall = from === to ? `χ² = ${to} as before` : `χ² ${from} → ${to}, p = ${p}`;
    write($("changed"), `${why ? `${why}: ` : ""}${fall}${lost}`);
  }
  [changes.why, changes.from, changes.lost] = ["", to, ""];
}

// values that were moved here and that somebody, or a fit, has moved since
function tellLost(values) {
  const lost = [...moved].filter(([name, value]) =>
    Math.abs(values[name] - value) > 1e-6 * Math.abs(value));
  if (lost.length) {
    const words = lost.map(([name, value]) => `${titleOf(name)}, ${shownNumber(value)} here`);
    changes.lost = `; it moved ${words.join(" and ")}: Undo leads back to it`;
  }
  moved.clear();
}

// ---- the server ----

function ask(address, body) {
  const options = { signal: AbortSignal.timeout(PATIENCE_MS) };
  if (body) {
    options.method = "POST";
    options.headers = { "Content-Type": "application/json" };
    options.body = JSON.stringify(body);
  }
  return fetch(address, options).then(
    async function (answer) {
      connect(answer.status !== 403, "This page is of a mcrim app that was ended or started again");
      if (!answer.ok) {
        write($("slip"), answer.status === 403 ? "" : (await answer.text()).trim());
        return null;
      }
      return answer.json();
    },
    function () {
      connect(false);
      return null;
    }
  );
}

function connect(is, words = "The connection to mcrim is lost") {
  document.body.classList.toggle("lost", !is);
  document.querySelector("main").inert = !is;
  $("stop").disabled = !is;
  $("undo").inert = $("redo").inert = !is;
  write(
    $("lost"),
    is ? "" : `${words}: nothing here is kept or computed any more. If it was ended, start ` +
      "mcrim app again and open the address that it prints."
  );
  if (!is) {
    write($("status"), "not connected");
  }
}

// Predictions: one question at a time, and the newest settings after it.
let asking = false;
let again = false;
// whether something was moved here since the last question
let stirred = false;
function predict() {
  unanswered = true;
  shade();
  if (asking) {
    again = true;
    return;
  }
  asking = true;
  again = false;
  const body = { ...sent(), moved: stirred };
  stirred = false;
  ask("predictions", body).then(function (told) {
    asking = false;
    if (again) {
      predict();
      return;
    }
    if (told && told.settings_number === numbers.settings_number) {
      unanswered = false;
      benches.clear(); // what is switched on has another size in the picture
      present(told);
    } else if (told || document.body.classList.contains("lost")) {
      // it came too late, or never: without another question the numbers would stay grey
      window.setTimeout(() => unanswered && !asking && predict(), IDLE_MS);
    }
    shade();
  });
}

// The reading that was pointed at last, with its bench; what the model says of it changes.
const readingsChart = $("readings-chart");
const benches = new Map();
let selected = 0;
let cells = [];
async function select(place) {
  selected = place;
  mark(readingsChart, place);
  if (!benches.has(place)) {
    benches.set(place, ask(`reading/${place}`));
  }
  const bench = await benches.get(place);
  if (selected !== place || !bench) {
    benches.delete(bench ? null : place);
    return;
  }
  swap("reading", bench.html);
  for (const cell of document.querySelectorAll("#reading [data-cell]")) {
    write(cell, (cells[place] || [])[Number(cell.dataset.cell)] || "");
  }
}

for (const kind of ["pointermove", "pointerdown"]) {
  readingsChart.addEventListener(kind, function (event) {
    const place = readingAt(readingsChart, event.clientX);
    if (place !== null && place !== selected) {
      select(place);
    }
  });
}
readingsChart.addEventListener("keydown", function (event) {
  const last = cells.length - 1;
  const moved = {
    ArrowLeft: selected - 1, ArrowRight: selected + 1, Home: 0, End: last,
  }[event.key];
  if (moved !== undefined) {
    event.preventDefault();
    select(Math.min(Math.max(moved, 0), last));
    scrollTo(readingsChart, selected);
  }
});
$("rows").addEventListener("focusin", function (event) {
  const row = event.target.closest("tbody tr");
  if (row) {
    select(row.sectionRowIndex);
    scrollTo(readingsChart, selected);
  }
});

function present(told) {
  pending = Boolean(told.pending);
  for (const [id, text] of Object.entries(told.texts)) {
    write($(id), text);
  }
  [$("undo").disabled, $("redo").disabled] = [!told.can_undo, !told.can_redo];
  if (!told.cells) {
    pending = true;
    return;
  }
  if (!pending) {
    tellChange(told.texts.chi2, told.texts["p-value"]);
  }
  told.cells.forEach(function (row, i) {
    const places = rows.rows[i] ? rows.rows[i].querySelectorAll(".of-model") : [];
    row.forEach((text, j) => write(places[j], text));
  });
  drawReadings(readingsChart, told.chart);
  cells = told.cells;
  select(Math.min(selected, cells.length - 1));
  const scale = controls.get("scale");
  if (settings.fit_scale && scale && told.scale !== null) {
    settings.values.scale = told.scale;
    scale.show(told.scale);
  }
}

// ---- how the session is ----

function takeOver(told) {
  settings = told.settings;
  tellLost(settings.values);
  for (const [name, control] of controls) {
    control.show(settings.values[name]);
    showKnown(control, settings.known[name], true);
  }
  for (const [name, { box, sizes }] of boxes) {
    box.checked = settings.effects.includes(name);
    // what is switched on is in sight
    if (box.checked && box.closest("details")) box.closest("details").open = true;
    sizes.hidden = !box.checked;
  }
  follows.checked = settings.fit_scale;
}

function showKnown(control, known, force) {
  control.how.value = known.how;
  control.element.querySelector(".prior").hidden = known.how !== "prior";
  if (force) {
    for (const field of [...control.priors].filter((each) => !Control.isTyped(each))) {
      const value = known[field.dataset.of];
      field.value = value === null ? "" : shownNumber(value);
      control.refuse(field, "");
    }
  }
  if (control.name === "scale") {
    follows.disabled = known.how === "held";
  }
}

// beside the switches how far chi2 would fall, and the most of them beside their family
function showGains(gains) {
  for (const place of document.querySelectorAll(".gain[id]")) {
    write(place, gains[place.id.slice("gain-".length)]?.[1] || "");
  }
  for (const family of document.querySelectorAll(".family")) {
    const names = [...family.querySelectorAll(".effect")].map((each) => each.dataset.effect);
    const most = Math.max(...names.map((name) => gains[name]?.[0] || 0));
    write(family.querySelector(".most"), most >= 4 ? `χ² up to −${Math.round(most)}` : "");
  }
}

let fits = 0;
function update(told) {
  if (!told) {
    return;
  }
  if (told.bench_number !== Number(document.body.dataset.bench)) {
    window.sessionStorage.setItem("focus", document.activeElement.id);
    window.sessionStorage.setItem("table", $("table-details").open ? "open" : "");
    window.location.reload();
    return;
  }
  const before = numbers;
  numbers = told;
  if (told.settings) {
    if (told.settings_number !== before.settings_number) {
      changes.why = before.number < 0 || !fits ? "" : doing || "Another page";
      doing = "";
      window.clearTimeout(changes.timer); // predictions follow
      takeOver(told);
    }
    if (told.steps.length && !fits) {
      changes.from = null; // the campaign is fitted as it came
    }
    fits = told.steps.length;
    showGains(told.gains);
    const isFirst = !rows.rows.length;
    if (showReadings(told.readings, told.settings_number !== before.settings_number)) {
      benches.clear();
    }
    selected = Math.min(selected, told.readings.length - 1);
    const diagnosed = $("verdict") !== null;
    for (const [id, html] of Object.entries(told.parts)) {
      swap(id, html);
    }
    if (diagnosed && !$("verdict")) {
      changes.lost += "; the diagnosis was of other readings";
    }
    reachScrolled();
    if (isFirst) {
      // who did by the keyboard what loads the page anew goes on where that was
      $("table-details").open ||= window.sessionStorage.getItem("table") === "open";
      $(window.sessionStorage.getItem("focus") || "")?.focus();
      window.sessionStorage.clear();
    }
    drawFalling($("falling-chart"), told.steps);
    [$("undo").disabled, $("redo").disabled] = [!told.can_undo, !told.can_redo];
    predict();
  }
  showJob(told.job);
  if (told.file_number !== fileNumber) {
    fileNumber = told.file_number;
    if (wanted.delete(told.file_kind)) {
      const link = document.createElement("a");
      [link.href, link.download] = ["file", ""];
      link.click();
    }
  }
  if ("slip" in told) {
    write($("slip"), told.slip);
  }
}

// what is scrolled sideways is reached by the keyboard
function reachScrolled() {
  for (const place of document.querySelectorAll(".scroll, .scrolled")) {
    if (place.scrollWidth > place.clientWidth + 1) {
      place.tabIndex = 0;
    } else {
      place.removeAttribute("tabindex");
    }
  }
}
window.addEventListener("resize", reachScrolled);
document.addEventListener("toggle", reachScrolled, true);

// what has the focus is not below the bar, whatever stands in it
const heights = new ResizeObserver(function (entries) {
  for (const { target } of entries) {
    document.documentElement.style.setProperty(`--${target.id}`, `${target.offsetHeight}px`);
  }
});
heights.observe($("bar"));
heights.observe(readingsChart);

// failures that were read before something was mended
let mended = "";
function showJob(job) {
  const busy = job.key !== null;
  const [next, ...others] = job.waiting.map((one) => one.words);
  const more = others.length ? ` and ${others.length} more` : "";
  write($("status"), next ? `${job.words}; then ${next}${more}` : job.words);
  const failures = job.said.join("\n");
  mended = failures ? mended : "";
  write($("error"), failures === mended ? "" : failures);
  write($("stopped"), job.stopped);
  $("stop").hidden = !busy;
  const progress = $("progress");
  progress.hidden = !busy;
  if (busy && !job.done) {
    progress.removeAttribute("value"); // it runs to and fro
  } else {
    progress.value = busy ? job.done : 0;
  }
  const waiting = job.waiting.map((one) => one.key);
  for (const button of document.querySelectorAll("[data-key]")) {
    const runs = button.dataset.key === job.key;
    const waits = waiting.includes(button.dataset.key);
    button.classList.toggle("running", runs);
    button.classList.toggle("waiting", waits);
    button.style.setProperty("--done", `${runs ? 100 * job.done : 0}%`);
    if (button.dataset.do === "stop") {
      button.hidden = !runs && !waits;
      continue;
    }
    button.dataset.text ||= button.textContent;
    button.dataset.label ||= button.getAttribute("aria-label") || button.dataset.text;
    const text = runs ? "Stop" : waits ? "Do not begin" : button.dataset.text;
    write(button, text);
    button.setAttribute(
      "aria-label", runs || waits ? `${text}: ${button.dataset.label}` : button.dataset.label
    );
  }
}

let looking = null;
// begins and ends of what was asked for here: what was looked at before it knows nothing of it
let acts = 0;
function look() {
  window.clearTimeout(looking);
  const before = acts;
  ask(`state?known=${numbers.number}`)
    .then(update)
    .finally(function () {
      const busy = numbers.job && (numbers.job.key !== null || numbers.job.waiting.length);
      if (!busy && acts === before) { // what was asked for has ended
        doing = "";
        wanted.clear();
      }
      window.clearTimeout(looking);
      looking = window.setTimeout(look, busy ? BUSY_MS : IDLE_MS);
    });
}

const WORDS = {
  fit: "Fit", add: "Added", undo: "Undo", redo: "Redo", upload: "Opened", effect: "Fit",
  back: "As it came", show: "Gone back", remove: "Removed",
  edit: "Readings changed", copy: "Readings changed", drop: "Readings changed",
};

function act(what, name = "", more = {}) {
  if (!settings) {
    return Promise.resolve(null);
  }
  if (WORDS[what]) {
    doing = WORDS[what];
    moved.clear();
  }
  if (what === "get") {
    wanted.add(name);
  }
  const body = { ...sent(), ...more, what: what, name: name, known: numbers.number };
  acts += 1;
  return ask("do", body).then(function (told) {
    acts += 1;
    update(told);
    look();
    return told;
  });
}

// ---- what the user does ----

document.addEventListener("click", function (event) {
  const button = event.target.closest("button, input[type=radio]");
  if (!button) {
    return;
  }
  if (button.className === "help") {
    const text = $(button.getAttribute("aria-controls"));
    text.hidden = !text.hidden;
    button.setAttribute("aria-expanded", String(!text.hidden));
  } else if (button.matches(".running, .waiting") && button.dataset.key) {
    act("stop", button.dataset.key);
  } else if (button.dataset.do) {
    if (isEntered() || ["stop", "undo", "redo", "back", "show"].includes(button.dataset.do)) {
      act(button.dataset.do, button.dataset.name).then(function (told) {
        if (button.dataset.do === "copy" && told && !told.slip) {
          rows.lastElementChild.querySelector(".name").select();
        }
      });
    } else {
      write($("slip"), MEND_FIRST);
    }
  } else if (button.id === "upload-button") {
    file.click();
  }
});

// in a field for text the browser undoes what was typed there
document.addEventListener("keydown", function (event) {
  const isText = event.target.matches("input:not([type=range], [type=checkbox], [type=radio])");
  if ((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "z" && !isText) {
    event.preventDefault();
    $(event.shiftKey ? "redo" : "undo").click();
  }
});

// what failed was of other values
function mend() {
  mended = $("error").textContent || mended;
  write($("error"), "");
}

function set(control, value) {
  settings.values[control.name] = value;
  stirred = true;
  moved.set(control.name, value);
  changes.why = `${titleOf(control.name)} ${shownNumber(value)}`;
  mend();
  if (control.name === "scale" && settings.fit_scale) {
    follows.checked = settings.fit_scale = false; // what is set by hand does not follow
  }
}

document.addEventListener("input", function (event) {
  const field = event.target;
  if (field.matches(".typed")) {
    field.dataset.typing = "1";
    return;
  }
  const control = field.type === "range" && controls.get(field.closest(".control").dataset.name);
  if (control && settings) {
    set(control, control.slid);
    control.field.value = shownNumber(control.slid);
    control.slider.setAttribute("aria-valuetext", control.field.value);
    control.refuse(control.field, "");
    predict();
  }
});

function typed(control, field) {
  const [value, problem] = read(field.value);
  if (problem) {
    control.refuse(field, problem);
  } else if (field === control.field && (value < control.minimum || value > control.maximum)) {
    control.refuse(field, `${shownNumber(value)} is out of range: give a value ${control.range}`);
  } else if (field.dataset.of === "prior_sigma" && value <= 0) {
    control.refuse(field, "the error of a prior is above 0");
  } else if (field === control.field) {
    set(control, value);
    control.show(value, true);
    predict();
  } else {
    control.refuse(field, "");
    know(control);
  }
  shade();
}

function know(control) {
  const known = { ...settings.known[control.name], how: control.how.value };
  for (const field of control.priors) {
    known[field.dataset.of] = field.value.trim() ? read(field.value)[0] : null;
  }
  for (const field of control.priors) {
    const lacks = known.how === "prior" && known[field.dataset.of] === null;
    const what = field.dataset.of === "prior" ? "a value" : "an error";
    control.refuse(field, lacks ? `the prior needs ${what}` : "");
  }
  settings.known[control.name] = known;
  stirred = true;
  showKnown(control, known, false);
  if (control.name === "scale" && known.how === "held") {
    follows.checked = settings.fit_scale = false;
  }
  predict();
}

function edited(field) {
  const [text, problem] = cellText(field);
  if (problem) {
    refuseCell(field, problem);
    shade();
    return;
  }
  field.dataset.typing = field.dataset.problem = ""; // it shows what is answered
  act("edit", field.dataset.name, { column: field.dataset.column, value: text }).then(function (told) {
    if (!told) {
      return;
    }
    if (field.type === "checkbox" && told.slip) {
      field.checked = !field.checked;
    }
    write($("slip"), "");
    refuseCell(field, told.slip);
    shade();
  });
}

document.addEventListener("change", function (event) {
  const field = event.target;
  const control = field.closest(".control");
  if (!settings) {
    return;
  }
  if (field.dataset.column) {
    edited(field);
  } else if (control && field.matches(".typed")) {
    typed(controls.get(control.dataset.name), field);
  } else if (control && field.matches("select")) {
    know(controls.get(control.dataset.name));
  } else if (field === follows) {
    settings.fit_scale = follows.checked;
    stirred = true;
    predict();
  } else if (field.closest(".switch")) {
    const name = field.closest(".effect").dataset.effect;
    boxes.get(name).sizes.hidden = !field.checked;
    const others = settings.effects.filter((each) => each !== name);
    settings.effects = field.checked ? [...others, name] : others;
    mend();
    act("effect", name);
    predict();
  }
});

// ---- files ----

const upload = document.body;
const file = document.querySelector("#upload input");

function open(chosen) {
  if (!chosen) {
    return;
  }
  const reader = new FileReader();
  reader.onload = function () {
    file.value = "";
    if (reader.result.length > MOST_UPLOADED) {
      write(
        $("slip"),
        `${chosen.name}: the file is larger than 7 MB; a measurement file has one short row per ` +
          "reading"
      );
      return;
    }
    act("upload", chosen.name, { content: reader.result });
  };
  reader.readAsDataURL(chosen);
}

file.addEventListener("change", () => open(file.files[0]));
for (const kind of ["dragover", "dragleave", "drop"]) {
  upload.addEventListener(kind, function (event) {
    event.preventDefault();
    upload.classList.toggle("over", kind === "dragover");
    if (kind === "drop") {
      open(event.dataTransfer.files[0]);
    }
  });
}

look();
