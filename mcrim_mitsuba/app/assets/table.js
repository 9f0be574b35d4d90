// The table: a row per reading, whose fields hold what the server does but for what is being typed.
import { $, read, shownNumber, write } from "./controls.js";

export const rows = document.querySelector("#rows tbody");
let shown = "";

// whether they are others than before; `force`: what is being typed, or is wrong, gives way
export function showReadings(readings, force) {
  const before = shown;
  shown = JSON.stringify(readings);
  const focus = rows.contains(document.activeElement) ? document.activeElement : null;
  const last = readings.length - 1;
  const moved = force || rows.rows.length !== readings.length;
  while (rows.rows.length < readings.length) {
    rows.append($("row").content.cloneNode(true));
  }
  while (rows.rows.length > readings.length) {
    rows.lastElementChild.remove();
  }
  if (focus && !focus.isConnected) {
    rows.rows[last].querySelector("button").focus();
  }
  write($("readings-count"), String(readings.length));
  readings.forEach(function (reading, i) {
    const row = rows.rows[i];
    row.classList.toggle("unused", !reading.use);
    for (const field of row.querySelectorAll("[data-says]")) {
      [field.dataset.name, field.id] = [i, `${field.dataset.do || field.dataset.column}-${i}`];
      field.title = `${field.dataset.says} ${reading.label}`;
      field.setAttribute("aria-label", field.title);
    }
    for (const field of row.querySelectorAll("input, select")) {
      const value = reading[field.dataset.column];
      if (field.type === "checkbox") {
        field.checked = value;
        refuseCell(field, "");
      } else if (moved || (!field.dataset.typing && !field.dataset.problem)) {
        field.value = typeof value === "number" ? shownNumber(value) : value;
        refuseCell(field, "");
      }
    }
  });
  return shown !== before;
}

// what is wrong with a cell, in a line beside it
export function refuseCell(field, problem) {
  let words = field.parentElement.querySelector(".wrong");
  if (problem && !words) {
    words = document.createElement("p");
    words.className = "wrong";
    words.setAttribute("role", "alert");
    field.after(words);
  }
  write(words, problem);
  if (words) {
    words.id = `wrong-${field.id}`;
    field.setAttribute("aria-describedby", words.id);
  }
  field.setAttribute("aria-invalid", String(Boolean(problem)));
  field.dataset.problem = problem;
  delete field.dataset.typing;
}

// [what a field says, as files have it, what is wrong with it]
export function cellText(field) {
  const { column } = field.dataset;
  const text = field.type === "checkbox" ? String(Number(field.checked)) : field.value.trim();
  const [number, problem] = read(text);
  // an index may be that of a material
  const isName = !["signal", "sigma"].includes(column) && /[a-z]/i.test(text);
  if (field.matches("[type=checkbox], select") || column === "label" || (problem && isName)) {
    return [text, ""];
  }
  return [String(number), problem];
}
