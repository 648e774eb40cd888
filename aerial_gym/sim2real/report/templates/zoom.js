// Zooms time traces by wheel (after a click, or with Ctrl), drag, pinch and keys; a double click shows the whole range.
// Without this script the figures stay as they are.
"use strict";
(() => {
const LEAST = 1e-3;  // Shortest shown share of a time axis
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

function ticks(low, high) {
  const least = (high - low) / 6, power = 10 ** Math.floor(Math.log10(least));
  const step = power * ([1, 2, 2.5, 5].find(factor => factor * power >= least) ?? 10);
  const first = Math.ceil(low / step), count = Math.max(Math.floor(high / step) - first + 1, 0);
  return Array.from({length: count}, (_, n) => +((first + n) * step).toPrecision(12));
}

function pathPoints(path) {  // One absolute point of each stroke, then relative steps
  return path.getAttribute("d").split("M").slice(1).flatMap(stroke => {
    const numbers = stroke.match(/-?\d+/g).map(Number), points = [];
    let x = 0, y = 0;
    for (let n = 0; n + 1 < numbers.length; n += 2) points.push([x += numbers[n], y += numbers[n + 1]]);
    return points;
  });
}

class Plot {
  constructor(box) {
    this.box = box;
    this.svg = box.querySelector("svg");
    [, , this.wide, this.high] = this.svg.getAttribute("viewBox").split(" ").map(Number);
    [this.x, this.y] = [box.dataset.x, box.dataset.y].map(limits => limits?.split(" ").map(Number));
    this.labels = [...box.querySelectorAll("i")];
    this.lines = this.svg.querySelector(".grid");
    this.grid = this.lines.getAttribute("d");
  }

  show(a, b) {  // Shares of the whole time axis
    const whole = b - a >= 1, left = a * this.wide, wide = (b - a) * this.wide;
    const [top, high] = whole || !this.y ? [0, this.high] : this.extent(left, left + wide);
    this.svg.setAttribute("viewBox", `${left} ${top} ${wide} ${high}`);
    this.box.querySelectorAll("i").forEach(label => label.remove());
    const kept = this.labels.filter(label => whole || (!this.y && label.className === "y"));
    this.box.append(...kept);
    let grid = whole ? this.grid : "";
    if (!whole && !this.y) grid = this.grid.split("M").filter(line => line.includes("h")).map(line => `M${line}`).join("");
    if (!whole) {
      const time = share => this.x[0] + share * (this.x[1] - this.x[0]);
      const numbered = this.labels.some(label => label.className === "x");
      grid += this.axis("x", time(a), time(b), numbered, share => `M${left + share * wide} ${top}v${high}`);
    }
    if (!whole && this.y) {
      const value = place => this.y[1] - place / this.high * (this.y[1] - this.y[0]);
      grid += this.axis("y", value(top + high), value(top), true, share => `M${left} ${top + (1 - share) * high}h${wide}`);
    }
    this.lines.setAttribute("d", grid);
  }

  axis(name, low, high, numbered, line) {  // Adds the numbers, and returns the lines of the grid
    return ticks(low, high).map(value => {
      const share = (value - low) / (high - low);
      const label = Object.assign(document.createElement("i"), {className: name, textContent: +value.toPrecision(6)});
      label.style[name === "x" ? "left" : "top"] = `${100 * (name === "x" ? share : 1 - share)}%`;
      if (numbered) this.box.append(label);
      return line(share);
    }).join("");
  }

  extent(left, right) {  // Top and height of the marks between two places, with a margin
    this.points ??= [...this.svg.querySelectorAll("path:not(.grid,.level)")].flatMap(pathPoints);
    const heights = this.points.filter(([x]) => left <= x && x <= right).map(([, y]) => y);
    if (!heights.length) return [0, this.high];
    const [top, bottom] = heights.reduce(([low, high], y) => [Math.min(low, y), Math.max(high, y)], [Infinity, -Infinity]);
    const margin = Math.max(0.05 * (bottom - top), 0.002 * this.high);
    return [top - margin, bottom - top + 2 * margin];
  }
}

class TimeAxis {  // Of all plots of a figure that share it
  constructor(plots, changed) {
    Object.assign(this, {plots, changed, a: 0, b: 1, pointers: new Map()});
    plots.forEach(plot => this.listen(plot.box));
  }

  show(a, b) {
    const span = clamp(b - a, LEAST, 1);
    this.a = clamp(a, 0, 1 - span);
    this.b = this.a + span;
    this.plots.forEach(plot => plot.show(this.a, this.b));
    this.changed();
  }

  scale(factor, at = 0.5) {
    const span = this.b - this.a, centre = this.a + at * span, next = clamp(span * factor, LEAST, 1);
    this.show(centre - at * next, centre + (1 - at) * next);
  }

  move(share) { const step = share * (this.b - this.a); this.show(this.a + step, this.b + step); }
  reset() { this.show(0, 1); }

  listen(box) {
    const shareOf = event => { const {left, width} = box.getBoundingClientRect(); return (event.clientX - left) / width; };
    const keys = {"+": () => this.scale(0.5), "=": () => this.scale(0.5), "-": () => this.scale(2), 0: () => this.reset(),
                  Escape: () => this.reset(), ArrowLeft: () => this.move(-0.2), ArrowRight: () => this.move(0.2)};
    const band = Object.assign(document.createElement("div"), {className: "band", hidden: true});
    box.append(band);
    box.tabIndex = 0;
    box.setAttribute("aria-label", `${box.getAttribute("aria-label")}; keys + - 0 and arrows zoom`);
    box.addEventListener("keydown", event => {
      if (event.ctrlKey || event.metaKey || !keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });
    box.addEventListener("wheel", event => {
      if (!event.ctrlKey && document.activeElement !== box) return;
      event.preventDefault();
      if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) this.move(event.deltaX / 500);
      else this.scale(Math.exp(clamp(event.deltaY, -100, 100) / 300), clamp(shareOf(event), 0, 1));
    }, {passive: false});
    box.addEventListener("dblclick", () => this.reset());
    box.addEventListener("pointerdown", event => {
      if (event.button) return;
      this.pointers.set(event.pointerId, {start: shareOf(event), now: shareOf(event)});
      box.setPointerCapture(event.pointerId);
    });
    box.addEventListener("pointermove", event => {
      const own = this.pointers.get(event.pointerId);
      if (!own) return;
      const before = [...this.pointers.values()].map(pointer => pointer.now);
      own.now = shareOf(event);
      if (event.pointerType === "mouse") return this.mark(band, own);
      const [p, q] = [...this.pointers.values()].map(pointer => pointer.now);
      if (q === undefined) return this.move(before[0] - p);
      if (Math.abs(q - p) < 0.05) return;
      const span = this.b - this.a, next = span * (before[1] - before[0]) / (q - p), start = this.a + before[0] * span - p * next;
      this.show(start, start + next);
    });
    const end = event => {
      const own = this.pointers.get(event.pointerId);
      this.pointers.delete(event.pointerId);
      band.hidden = true;
      if (!own || event.type !== "pointerup" || event.pointerType !== "mouse") return;
      const [low, high] = [own.start, own.now].map(share => clamp(share, 0, 1)).sort((p, q) => p - q), span = this.b - this.a;
      if (high - low > 0.01) this.show(this.a + low * span, this.a + high * span);
    };
    ["pointerup", "pointercancel"].forEach(name => box.addEventListener(name, end));
  }

  mark(band, {start, now}) {
    const [low, high] = [start, now].map(share => clamp(share, 0, 1)).sort((p, q) => p - q);
    band.hidden = false;
    band.style = `left:${100 * low}%;width:${100 * (high - low)}%`;
  }
}

for (const panels of document.querySelectorAll(".panels")) {
  const plots = [...panels.querySelectorAll(".plot[data-x]")].map(box => new Plot(box));
  if (!plots.length) continue;
  const button = Object.assign(document.createElement("button"), {className: "zoom"});
  const update = () => {
    button.disabled = axes.every(axis => axis.b - axis.a >= 1);
    button.textContent = button.disabled ? "drag or pinch to zoom" : "show the whole range";
  };
  const groups = {};
  plots.forEach(plot => (groups[plot.box.dataset.x] ??= []).push(plot));
  const axes = Object.values(groups).map(own => new TimeAxis(own, update));
  button.addEventListener("click", () => axes.forEach(axis => axis.reset()));
  panels.after(button);
  update();
}
})();
