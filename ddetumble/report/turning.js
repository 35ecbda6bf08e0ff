"use strict";
(function () {
  const canvas = document.getElementById("turning");
  const data = JSON.parse(document.getElementById("turning-data").textContent);
  const pen = canvas.getContext("2d");
  let azimuth = 0.7, height = 0.35, moving = !matchMedia("(prefers-reduced-motion: reduce)").matches, last = null;
  function project(p) {
    const c = Math.cos(azimuth), s = Math.sin(azimuth), x = c * p[0] + s * p[1], y = -s * p[0] + c * p[1];
    const ch = Math.cos(height), sh = Math.sin(height), scale = 0.36 * Math.min(canvas.width, canvas.height) / data.reach;
    return [canvas.width / 2 + scale * y, canvas.height / 2 - scale * (ch * p[2] - sh * x), ch * x + sh * p[2]];
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
  function arrow(tail, head, colour, label, at) {
    line([tail, head], colour, 3);
    const a = project(tail), b = project(head), way = Math.atan2(b[1] - a[1], b[0] - a[0]);
    pen.fillStyle = colour; pen.beginPath(); pen.moveTo(b[0], b[1]);
    for (const turn of [2.7, -2.7]) pen.lineTo(b[0] + 12 * Math.cos(way + turn), b[1] + 12 * Math.sin(way + turn));
    pen.fill();
    const end = at === "head" ? b : a, start = at === "head" ? a : b, side = end[0] < start[0] ? -1 : 1; // beyond the end
    pen.textAlign = side < 0 ? "right" : "left"; pen.fillText(label, end[0] + 8 * side, end[1] + 5);
  }
  function draw() {
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.font = "15px sans-serif";
    for (const one of data.lines) line(one, "#66727f", 1.4);
    for (const one of data.arrows) arrow(one.tail, one.head, one.colour, one.label, one.at);
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
  canvas.addEventListener("keydown", function (event) {
    const step = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (!step) return;
    event.preventDefault(); moving = false; azimuth += step[0]; height += step[1]; draw();
  });
  (function spin() { if (moving) { azimuth += 0.006; draw(); requestAnimationFrame(spin); } })();
  draw();
})();
