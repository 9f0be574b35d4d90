// A slider and its number field follow each other without asking the server.
window.dash_clientside = window.dash_clientside || {};
window.dash_clientside.mcrim = (function () {
  "use strict";

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
  // what may be sent to the page, and what the server takes (base64 is a third longer)
  const MOST_UPLOADED = 10e6;

  function ends(axis) {
    const coordinate = coordinateOf[axis.coordinate];
    return [coordinate(axis.minimum, axis.scale), coordinate(axis.maximum, axis.scale)];
  }

  function valueAt(position, axis) {
    const [low, high] = ends(axis);
    const x = low + ((high - low) * position) / axis.steps;
    const value = valueOf[axis.coordinate](x, axis.scale);
    const inside = Math.min(Math.max(value, axis.minimum), axis.maximum);
    return Number(inside.toPrecision(4));
  }

  function positionOf(value, axis) {
    const [low, high] = ends(axis);
    const x = coordinateOf[axis.coordinate](value, axis.scale);
    return Math.round((axis.steps * (x - low)) / (high - low));
  }

  // what the model says at the present settings; what is not in it stays
  function present(shown) {
    for (const [id, text] of Object.entries(shown.texts)) {
      write(document.getElementById(id), text);
    }
    if (shown.cells) {
      const rows = document.querySelectorAll("#rows tbody tr");
      shown.cells.forEach(function (row, i) {
        row.forEach(function (text, j) {
          write(rows[i] && rows[i].cells[j + 1], text);
        });
      });
      chart = shown.chart;
      draw();
    }
  }

  // Sliders that move ask the server directly; Dash, whose way takes several times as long, is
  // told when they rest.
  const REST_MS = 350;
  let asking = false;
  let stale = false;
  const moved = new Map();
  let rest = null;

  function fieldOf(kind, name) {
    return document.getElementById(JSON.stringify({ kind: kind, name: name }));
  }

  function controls() {
    const values = {};
    document.querySelectorAll("input[type=number]").forEach(function (field) {
      const value = field.valueAsNumber;
      if (field.id.startsWith("{") && isFinite(value)) {
        values[JSON.parse(field.id).name] = value;
      }
    });
    const effects = [];
    document.querySelectorAll(".effect input[type=checkbox]:checked").forEach(function (box) {
      effects.push(JSON.parse(box.name).name);
    });
    const fit = document.querySelector("#fit-scale input");
    return {
      values: values,
      effects: effects,
      fit_scale: Boolean(fit && fit.checked),
      settings_number: settingsNumber,
    };
  }

  function ask() {
    if (asking) {
      stale = true;
      return;
    }
    asking = true;
    stale = false;
    window
      .fetch("predictions", {
        method: "POST",
        headers: { "Content-Type": "application/json" },
        body: JSON.stringify(controls()),
      })
      .then((answer) => (answer.ok ? answer.json() : null))
      .then((shown) => shown && present(shown))
      .catch(() => null) // the clock notices that the server is gone
      .finally(function () {
        asking = false;
        if (stale) {
          ask();
        }
      });
  }

  function tellDash() {
    window.clearTimeout(rest);
    const told = [...moved];
    moved.clear();
    for (const [name, value] of told) {
      window.dash_clientside.set_props({ kind: "number", name: name }, { value: value });
    }
  }

  const axes = {};
  let settingsNumber = -1;

  document.addEventListener(
    "input",
    function (event) {
      const slider = event.target;
      if (slider.type !== "range" || !slider.id.startsWith("{")) {
        return;
      }
      const name = JSON.parse(slider.id).name;
      const number = fieldOf("number", name);
      if (!axes[name] || !number) {
        return;
      }
      event.stopPropagation();
      const value = valueAt(Number(slider.value), axes[name]);
      number.value = value;
      ask();
      moved.set(name, value);
      window.clearTimeout(rest);
      rest = window.setTimeout(tellDash, REST_MS);
    },
    true
  );
  // what is done next may change the same number: it comes after the slider's
  for (const kind of ["focusin", "keydown", "pointerdown"]) {
    document.addEventListener(
      kind,
      function (event) {
        if (event.target.type !== "range") {
          tellDash();
        }
      },
      true
    );
  }

  // the newest figure; the library that draws it may still be on its way
  let chart = null;
  // what of it is drawn: all but the heights, and the heights
  let frame = null;
  let heights = null;
  function draw() {
    const place = document.querySelector("#readings-chart > div");
    if (!window.Plotly || !place) {
      window.setTimeout(draw, 100);
      return;
    }
    const bare = chart.data.map((trace) => ({ ...trace, y: null }));
    const around = JSON.stringify([chart.layout, bare]);
    const before = heights;
    heights = JSON.stringify(chart.data.map((trace) => trace.y));
    if (around !== frame) {
      frame = around;
      const options = { displayModeBar: false, responsive: true };
      window.Plotly.react(place, chart.data, chart.layout, options);
      return;
    }
    if (heights !== before) {
      // takes half as long as drawing axes, labels and legend too; bars of traces that are not
      // named would vanish
      const data = chart.data.map((trace) => ({ y: trace.y }));
      const still = { frame: { duration: 0, redraw: false }, transition: { duration: 0 } };
      window.Plotly.animate(place, { data: data }, { ...still, mode: "immediate" })
        .catch(() => null); // overtaken by the next
    }
  }

  function write(place, text) {
    if (place && place.textContent !== text) {
      place.textContent = text;
    }
  }

  return {
    // where the slider stands after its number changed
    follow: function (number, axis, id) {
      axes[id.name] = axis;
      if (typeof number !== "number" || !isFinite(number)) {
        return window.dash_clientside.no_update;
      }
      return positionOf(number, axis);
    },

    // which of the server's settings the controls show
    settle: function (number) {
      settingsNumber = number;
      return window.dash_clientside.no_update;
    },

    // what the model says at the present settings: Dash would take far longer
    show: function (shown) {
      if (shown) {
        present(shown);
      }
      return window.dash_clientside.no_update;
    },

    // [content for the server, what is wrong]
    accept: function (content, name) {
      if (!content) {
        return [window.dash_clientside.no_update, window.dash_clientside.no_update];
      }
      if (content.length > MOST_UPLOADED) {
        return [
          window.dash_clientside.no_update,
          name + ": the file is larger than 7 MB; a measurement file has one short row per reading",
        ];
      }
      return [{ content: content, name: name }, ""];
    },

    reload: function (times) {
      if (times) {
        window.location.reload();
      }
      return window.dash_clientside.no_update;
    },
  };
})();
