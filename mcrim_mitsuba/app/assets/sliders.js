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

  return {
    // [slider, number] after one of them moved
    follow: function (slider, number, axis) {
      const same = window.dash_clientside.no_update;
      const moved = window.dash_clientside.callback_context.triggered_id;
      if (moved === undefined || moved === null) {
        return [same, same];
      }
      if (moved.kind === "slider") {
        return [same, valueAt(Number(slider), axis)];
      }
      if (typeof number !== "number" || !isFinite(number)) {
        return [same, same];
      }
      const position = positionOf(number, axis);
      return [position === Number(slider) ? same : position, same];
    },

    // an effect's sizes are in sight while it is on
    unfold: function (chosen) {
      return !(chosen || []).length;
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
