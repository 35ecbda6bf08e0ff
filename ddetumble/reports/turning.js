"use strict";
(function () {
  const canvas = document.getElementById("turning");
  const data = JSON.parse(document.getElementById("turning-data").textContent);
  const pen = canvas.getContext("2d");
  let azimuth = 0.7, height = 0.35, moving = !matchMedia("(prefers-reduced-motion: reduce)").matches, last = null;
  let wide = 1, high = 1, labels = []; // of the canvas, in pixels of the page; the places of labels already drawn
  function fit() { // as many pixels as the screen has, so that words have the size of the page's
    const fine = window.devicePixelRatio || 1;
    wide = canvas.clientWidth || 640; high = Math.round(0.62 * wide);
    canvas.width = Math.round(fine * wide); canvas.height = Math.round(fine * high);
    pen.setTransform(fine, 0, 0, fine, 0, 0);
    draw();
  }
  function project(p) {
    const c = Math.cos(azimuth), s = Math.sin(azimuth), x = c * p[0] + s * p[1], y = -s * p[0] + c * p[1];
    const ch = Math.cos(height), sh = Math.sin(height), scale = 0.42 * Math.min(wide, high) / data.reach;
    return [wide / 2 + scale * y, high / 2 - scale * (ch * p[2] - sh * x), ch * x + sh * p[2]];
  }
  function line(points, colour, width) {
    for (let k = 1; k < points.length; k++) {
      const a = project(points[k - 1]), b = project(points[k]);
      pen.strokeStyle = colour; pen.lineWidth = width;
      pen.globalAlpha = (a[2] + b[2]) / 2 < 0 ? 0.3 : 1.0;
      pen.beginPath(); pen.moveTo(a[0], a[1]); pen.lineTo(b[0], b[1]); pen.stroke();
    }
    pen.globalAlpha = 1.0;
  }
  function arrow(tail, head, colour) {
    line([tail, head], colour, 3);
    const a = project(tail), b = project(head), way = Math.atan2(b[1] - a[1], b[0] - a[0]);
    pen.fillStyle = colour; pen.beginPath(); pen.moveTo(b[0], b[1]);
    for (const turn of [2.7, -2.7]) pen.lineTo(b[0] + 12 * Math.cos(way + turn), b[1] + 12 * Math.sin(way + turn));
    pen.fill();
  }
  function name(tail, head, colour, label, at) { // beyond the arrow's end, inside the canvas, clear of other labels
    const a = project(tail), b = project(head), end = at === "head" ? b : a, start = at === "head" ? a : b;
    const size = pen.measureText(label).width, side = end[0] < start[0] ? -1 : 1;
    let x = side < 0 ? end[0] - 8 - size : end[0] + 8, y = end[1] + 5;
    x = Math.max(2, Math.min(wide - size - 2, x));
    const step = end[1] < start[1] ? -16 : 16;
    while (labels.some(function (o) { return x < o[0] + o[2] && o[0] < x + size && Math.abs(y - o[1]) < 15; })) y += step;
    y = Math.max(14, Math.min(high - 4, y));
    labels.push([x, y, size]);
    pen.lineWidth = 4; pen.strokeStyle = "#fff"; pen.strokeText(label, x, y);
    pen.fillStyle = colour; pen.fillText(label, x, y);
  }
  function face(at, label) { // fainter on the far side
    const p = project(at);
    pen.globalAlpha = p[2] < 0 ? 0.35 : 0.9; pen.fillStyle = "#66727f"; pen.textAlign = "center";
    pen.lineWidth = 4; pen.strokeStyle = "#fff"; pen.strokeText(label, p[0], p[1] + 5);
    pen.fillText(label, p[0], p[1] + 5);
    pen.textAlign = "start"; pen.globalAlpha = 1.0;
  }
  function draw() {
    pen.clearRect(0, 0, wide, high);
    pen.font = "14px sans-serif"; pen.lineJoin = "round";
    labels = [];
    for (const one of data.faces) face(one.at, one.name);
    for (const one of data.lines) line(one, "#66727f", 1.4);
    for (const one of data.arrows) arrow(one.tail, one.head, one.colour);
    for (const one of data.arrows) name(one.tail, one.head, one.colour, one.label, one.at);
  }
  canvas.addEventListener("pointerdown", function (event) {
    last = [event.clientX, event.clientY]; moving = false; canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", function (event) {
    if (last === null) return;
    azimuth -= 0.01 * (event.clientX - last[0]);
    height = Math.max(-1.5, Math.min(1.5, height + 0.01 * (event.clientY - last[1])));
    last = [event.clientX, event.clientY]; draw();
  });
  canvas.addEventListener("pointerup", function () { last = null; });
  canvas.addEventListener("pointercancel", function () { last = null; });
  canvas.addEventListener("keydown", function (event) {
    const step = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (!step) return;
    event.preventDefault(); moving = false; azimuth += step[0]; height += step[1]; draw();
  });
  window.addEventListener("resize", fit);
  fit();
  (function spin() { if (moving) { azimuth += 0.006; draw(); requestAnimationFrame(spin); } })();
})();
