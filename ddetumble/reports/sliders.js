"use strict";
(function () {
  const root = document.getElementById("sliders");
  const data = JSON.parse(document.getElementById("sliders-data").textContent);
  function unpack(text) { // single-precision numbers
    const bytes = Uint8Array.from(atob(text), function (c) { return c.charCodeAt(0); });
    return new Float32Array(bytes.buffer);
  }
  const records = data.records.map(function (one) {
    return { key: one.key, samples: one.samples, chi2: one.chi2, slope: one.slope, square: one.square,
      place: unpack(one.place), measured: unpack(one.measured), fitted: unpack(one.fitted), change: unpack(one.change) };
  });
  let missed = []; // of the page's address
  const count = data.levers.length, at = new Array(count).fill(0), samples = records.reduce(function (s, one) { return s + one.samples; }, 0);
  const find = function (part) { return root.querySelector("[data-part=" + part + "]"); };
  const pick = find("record"), canvas = find("drawing"), bars = find("bars"), said = find("said"), command = find("command");
  function number(x, digits = 4) { return x === null ? "∞" : Math.abs(x) >= 1e5 || (x !== 0 && Math.abs(x) < 1e-3) ? x.toExponential(2) : String(+x.toPrecision(digits)); }
  const digits = data.levers.map(function (one) { // that tell the places of a slider apart
    const ends = [one.values[0], one.values[one.values.length - 1]], way = Math.abs(ends[1] - ends[0]);
    return ends.indexOf(null) < 0 && way > 0 ? Math.min(12, Math.max(4, Math.ceil(Math.log10(Math.max(...ends.map(Math.abs)) / way)) + 3)) : 4;
  });
  function value(k) { // of the parameter, between two marks of the slider
    const one = data.levers[k], place = (at[k] - one.low) / (1 - one.low) * (one.values.length - 1);
    const i = Math.min(Math.floor(place), one.values.length - 2), a = one.values[i], b = one.values[i + 1];
    if (a === null || b === null) return place - i < 0.5 ? a : b;
    return a + (place - i) * (b - a);
  }
  function measure(one) { // chi-square of a record
    let total = one.chi2;
    for (let j = 0; j < count; j++) {
      if (at[j] === 0) continue;
      total += 2 * at[j] * one.slope[j];
      for (let k = 0; k < count; k++) total += at[j] * at[k] * one.square[j * count + k];
    }
    return Math.max(total, 0);
  }
  function refit() { // the model's own parameters, to where chi-square is least
    const own = [];
    for (let k = 0; k < count; k++) if (data.levers[k].effect === "") own.push(k);
    const matrix = own.map(function () { return new Array(own.length + 1).fill(0); });
    for (const one of records) own.forEach(function (j, a) {
      let side = one.slope[j];
      for (let k = 0; k < count; k++) if (own.indexOf(k) < 0) side += one.square[j * count + k] * at[k];
      matrix[a][own.length] -= side;
      own.forEach(function (k, b) { matrix[a][b] += one.square[j * count + k]; });
    });
    for (let i = 0; i < own.length; i++) { // Gauss and Jordan, with pivots
      let best = i;
      for (let r = i + 1; r < own.length; r++) if (Math.abs(matrix[r][i]) > Math.abs(matrix[best][i])) best = r;
      const row = matrix[best]; matrix[best] = matrix[i]; matrix[i] = row;
      if (Math.abs(row[i]) < 1e-12) return;
      for (let r = 0; r < own.length; r++) {
        if (r === i) continue;
        const share = matrix[r][i] / row[i];
        for (let c = i; c <= own.length; c++) matrix[r][c] -= share * row[c];
      }
    }
    own.forEach(function (k, a) { at[k] = Math.min(1, Math.max(data.levers[k].low, matrix[a][own.length] / matrix[a][a])); });
  }
  function fit(canvas, share) { // as many pixels as the screen has
    const fine = window.devicePixelRatio || 1, wide = canvas.clientWidth || 640, high = Math.round(share * wide);
    canvas.width = Math.round(fine * wide); canvas.height = Math.round(fine * high);
    const pen = canvas.getContext("2d"); pen.setTransform(fine, 0, 0, fine, 0, 0); pen.font = "13px sans-serif";
    return [pen, wide, high];
  }
  function turn(pen, text, x, y, room) { // along the left side, centred
    pen.save(); pen.translate(x, y); pen.rotate(-Math.PI / 2); pen.textAlign = "center"; pen.fillText(text, 0, 0, room); pen.restore();
  }
  function draw() {
    const one = records[pick.selectedIndex], n = one.place.length, model = new Array(n);
    for (let i = 0; i < n; i++) {
      model[i] = one.fitted[i];
      for (let k = 0; k < count; k++) model[i] += at[k] * one.change[k * n + i];
    }
    const [pen, wide, high] = fit(canvas, 0.56), left = 84, right = 8, top = 8, bottom = 34, middle = Math.round(0.6 * high);
    let low = Infinity, most = -Infinity, off = 0;
    for (let i = 0; i < n; i++) {
      low = Math.min(low, model[i], one.measured[i]); most = Math.max(most, model[i], one.measured[i]);
      off = Math.max(off, Math.abs(one.measured[i] - model[i]), Math.abs(one.measured[i] - one.fitted[i]));
    }
    const x = function (i) { return left + (wide - left - right) * (one.place[i] - one.place[0]) / ((one.place[n - 1] - one.place[0]) || 1); };
    const y = function (v) { return middle - 10 - (middle - 10 - top) * (v - low) / ((most - low) || 1); };
    const z = function (v) { return 0.5 * (middle + 14 + high - bottom) - 0.46 * (high - bottom - middle - 14) * v / (off || 1); };
    pen.strokeStyle = "#d9dfe5"; pen.beginPath(); pen.moveTo(left, z(0)); pen.lineTo(wide - right, z(0)); pen.stroke();
    const curve = function (values, colour, place, width) {
      pen.strokeStyle = colour; pen.lineWidth = width; pen.beginPath();
      for (let i = 0; i < n; i++) { if (i) pen.lineTo(x(i), place(values[i])); else pen.moveTo(x(i), place(values[i])); }
      pen.stroke();
    };
    pen.fillStyle = "#1b2733";
    for (let i = 0; i < n; i++) { pen.beginPath(); pen.arc(x(i), y(one.measured[i]), 1.6, 0, 7); pen.fill(); }
    curve(one.fitted, "#9aa6b2", y, 1.2); curve(model, "#d55e00", y, 2);
    const before = new Array(n), now = new Array(n);
    for (let i = 0; i < n; i++) { before[i] = one.measured[i] - one.fitted[i]; now[i] = one.measured[i] - model[i]; }
    curve(before, "#9aa6b2", z, 1.2); curve(now, "#d55e00", z, 1.6);
    pen.fillStyle = "#5a6673"; pen.textAlign = "right";
    pen.fillText(number(most), left - 6, y(most) + 10); pen.fillText(number(low), left - 6, y(low));
    pen.fillText(number(off), left - 6, z(off) + 10); pen.fillText(number(-off), left - 6, z(-off));
    pen.textAlign = "left"; pen.fillText(number(one.place[0]), left, high - 18);
    pen.textAlign = "right"; pen.fillText(number(one.place[n - 1]), wide - right, high - 18);
    pen.textAlign = "center"; pen.fillText(data.abscissa, 0.5 * (left + wide), high - 4);
    turn(pen, data.drawn, 14, 0.5 * (top + middle), middle - top); turn(pen, data.left, 14, z(0), high - bottom - middle);
    const [brush, across, tall] = fit(bars, 0.2), each = (across - left - right) / records.length;
    const sizes = records.map(function (r) { return measure(r) / Math.max(r.samples, 1); });
    const largest = Math.max(...sizes, ...records.map(function (r) { return r.chi2 / Math.max(r.samples, 1); }), 1e-300);
    const height = function (v) { return (tall - 24) * Math.log1p(v) / Math.log1p(largest); };
    records.forEach(function (r, k) {
      const old = height(r.chi2 / Math.max(r.samples, 1)), size = height(sizes[k]);
      brush.fillStyle = "#d9dfe5"; brush.fillRect(left + k * each + 1, tall - 16 - old, Math.max(each - 2, 1), old);
      brush.fillStyle = k === pick.selectedIndex ? "#d55e00" : "#e8a268"; brush.fillRect(left + k * each + 0.25 * each, tall - 16 - size, Math.max(0.5 * each, 1), size);
    });
    brush.strokeStyle = "#5a6673"; brush.setLineDash([4, 3]); brush.beginPath();
    brush.moveTo(left, tall - 16 - height(1)); brush.lineTo(across - right, tall - 16 - height(1)); brush.stroke();
    brush.fillStyle = "#5a6673"; brush.textAlign = "right";
    for (const v of largest > 4 ? [1, largest] : [largest > 1 ? 1 : largest]) brush.fillText(number(v), left - 6, tall - 12 - height(v));
    turn(brush, "χ² / sample", 14, 0.5 * (tall - 16), tall - 16);
    brush.textAlign = "left"; brush.fillText("records, on a logarithmic scale; dashed: only noise is left", left, tall - 3);
  }
  function show() {
    const total = records.reduce(function (s, one) { return s + measure(one); }, 0), effects = data.effects.slice();
    root.dataset.total = String(total);
    data.levers.forEach(function (one, k) {
      const row = root.querySelectorAll("[data-lever]")[k];
      row.querySelector("input").value = String(at[k]);
      row.querySelector("output").textContent = number(value(k), digits[k]) + (one.unit === "1" || one.unit === "" ? "" : " " + one.unit);
      if (one.effect && at[k] !== 0 && effects.indexOf(one.effect) < 0) effects.push(one.effect);
    });
    said.textContent = "χ² " + number(total) + " over " + samples + " samples: " + number(total / Math.max(samples, 1)) + " each; the fit leaves " +
      number(data.total / Math.max(samples, 1)) + "." + (missed.length ? " No slider goes to " + missed.join(", ") + "." : "");
    command.textContent = ["ddetumble", "fit", data.campaign, "--model", data.model].concat(effects.map(function (e) { return "--effect " + e; })).join(" ");
    draw();
  }
  function place(k, wanted) { // of the slider where its parameter has a value, or of the end that is nearest to it
    const one = data.levers[k], values = one.values, last = values.length - 1;
    const far = function (v) { return v === null ? Infinity : Math.abs(v - wanted); };
    let best = far(values[0]) <= far(values[last]) ? 0 : last;
    for (let i = 0; i < last; i++) {
      const a = values[i], b = values[i + 1];
      if (a !== null && b !== null && a !== b && (wanted - a) * (wanted - b) <= 0) { best = i + (wanted - a) / (b - a); break; }
    }
    return one.low + (1 - one.low) * best / last;
  }
  function read() { // #try:adhesion.tau_a=40000,refit: values in the units that the sliders show
    if (location.hash.indexOf("#try:") !== 0) return;
    at.fill(0); missed = [];
    for (const part of decodeURIComponent(location.hash.slice(5)).split(",")) {
      const [name, text] = part.split("="), k = data.levers.findIndex(function (one) { return one.name === name; });
      if (name === "refit") { refit(); continue; }
      if (k < 0 || text === undefined || text.trim() === "" || !isFinite(+text)) { missed.push(part); continue; }
      at[k] = place(k, +text);
      const size = Math.abs(data.levers[k].values[data.levers[k].values.length - 1]) + Math.abs(text);
      if (Math.abs(value(k) - text) > 1e-6 * size) missed.push(part);
    }
    root.closest("section").scrollIntoView();
  }
  for (const one of records) pick.add(new Option(one.key));
  pick.selectedIndex = records.reduce(function (best, one, k) {
    return one.chi2 / Math.max(one.samples, 1) > records[best].chi2 / Math.max(records[best].samples, 1) ? k : best; }, 0);
  pick.addEventListener("change", show);
  root.querySelectorAll("[data-lever]").forEach(function (row, k) {
    row.querySelector("input").addEventListener("input", function (event) {
      at[k] = +event.target.value;
      if (data.levers[k].effect !== "" && find("follow").checked) refit();
      show();
    });
  });
  find("refit").addEventListener("click", function () { refit(); show(); });
  find("reset").addEventListener("click", function () { at.fill(0); missed = []; show(); });
  find("copy").addEventListener("click", function () {
    if (navigator.clipboard) navigator.clipboard.writeText(command.textContent);
    else { const range = document.createRange(); range.selectNode(command); getSelection().removeAllRanges(); getSelection().addRange(range); document.execCommand("copy"); }
  });
  window.addEventListener("resize", draw);
  window.addEventListener("hashchange", function () { read(); show(); });
  window.addEventListener("load", read); // again where figures above have taken their room
  read(); show();
})();
