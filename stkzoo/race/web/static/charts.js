// Charts of the race's history, with one line per kart and the chosen kart in front.

import { color, fitted, lineColor } from "./theme.js";

const CHARTS = [
  { name: "speed", title: "Speed", unit: "m/s", digits: 1, low: 0 },
  { name: "rank", title: "Rank", unit: "", digits: 0, isDown: true, isStepped: true },
  { name: "gap", title: "Behind the leader", unit: "m", digits: 1, low: 0, isDown: true },
  { name: "reward", title: "Reward so far", unit: "", digits: 1 },
  { name: "steer", title: "Steering", unit: "left −1, right +1", digits: 2, low: -1, high: 1, isAction: true },
  { name: "throttle", title: "Throttle", unit: "brake −1, full +1", digits: 2, low: -1, high: 1, isAction: true },
];
const MOST = 4000; // steps
const RECENT = 30; // [s]
const DASHES = [[], [6, 3], [2, 3], [8, 3, 2, 3]];
const EDGE = { left: 34, right: 8, top: 8, bottom: 16 };

export class Charts {
  constructor(place) {
    this.showsAll = false;
    this.cursor = null;
    this.figures = CHARTS.map((chart) => {
      const figure = document.createElement("figure");
      figure.innerHTML = `<figcaption><span>${chart.title} <span class="unit">${chart.unit}</span></span>
        <span class="number"></span></figcaption><canvas role="img"></canvas>`;
      place.append(figure);
      const canvas = figure.querySelector("canvas");
      canvas.addEventListener("pointermove", (event) => this.point(event.offsetX / canvas.clientWidth));
      canvas.addEventListener("pointerleave", () => this.point(null));
      return { chart, canvas, number: figure.querySelector(".number") };
    });
    this.reset(null);
  }

  point(part) {
    this.cursor = part;
    this.isStale = true;
  }

  reset(race) {
    this.race = race;
    this.steps = [];
    this.values = Object.fromEntries(CHARTS.map(({ name }) => [name, []]));
    this.isStale = true;
  }

  add({ steps, values }) {
    this.steps.push(...steps);
    for (const { name } of CHARTS) this.values[name].push(...values[name]);
    if (this.steps.length > MOST) {
      const half = (list) => list.filter((_, n) => n % 2 === 0);
      this.steps = half(this.steps);
      for (const { name } of CHARTS) this.values[name] = half(this.values[name]);
    }
    this.isStale = true;
  }

  draw(chosen) {
    this.isStale = false;
    for (const figure of this.figures) this.drawOne(figure, chosen);
  }

  // Returns the first and last step that are shown, and the list index of the first.
  span() {
    const last = this.steps.at(-1) ?? 0;
    const recent = RECENT / (this.race?.step_size ?? 0.1);
    const least = this.showsAll ? 0 : Math.max(0, last - recent);
    let first = this.steps.findIndex((step) => step >= least);
    first = Math.max(0, first - 1);
    return { least, first, last: Math.max(last, least + (this.showsAll ? 10 : recent)) };
  }

  drawOne({ chart, canvas, number }, chosen) {
    const { draw, width, height } = fitted(canvas);
    if (!this.race || !this.steps.length) return void (number.textContent = "");
    const { least, first, last } = this.span();
    const rows = this.values[chart.name];
    const [low, high] = this.range(chart, rows, first);
    const x = (step) => EDGE.left + ((step - least) / Math.max(last - least, 1)) * (width - EDGE.left - EDGE.right);
    const down = height - EDGE.top - EDGE.bottom;
    const y = (value) => {
      const part = (value - low) / (high - low);
      return EDGE.top + (chart.isDown ? part : 1 - part) * down;
    };
    drawGrid(draw, { low, high, chart, width, height, y, x, least, last, step: this.race.step_size });
    draw.save();
    draw.beginPath();
    draw.rect(EDGE.left, 0, width - EDGE.left - EDGE.right + 3, height - EDGE.bottom + 3);
    draw.clip();
    const order = [...this.race.karts.keys()].filter((k) => k !== chosen);
    for (const k of [...order, chosen]) {
      if (k < 0) continue;
      draw.globalAlpha = k === chosen ? 1 : chart.isAction ? 0.25 : 0.75;
      draw.lineWidth = k === chosen ? 2.2 : 1.2;
      draw.strokeStyle = lineColor(this.race.karts[k].color);
      draw.setLineDash(DASHES[Math.floor(k / 8) % DASHES.length]);
      draw.beginPath();
      for (let n = first; n < rows.length; n++) {
        if (chart.isStepped && n > first) draw.lineTo(x(this.steps[n]), y(rows[n - 1][k]));
        draw.lineTo(x(this.steps[n]), y(rows[n][k]));
      }
      draw.stroke();
    }
    draw.restore();
    this.drawCursor(draw, { chart, canvas, number, chosen, rows, x, y, height, width, least, last, first });
  }

  drawCursor(draw, { chart, canvas, number, chosen, rows, x, y, height, width, least, last, first }) {
    let at = rows.length - 1;
    if (this.cursor !== null) {
      const part = (this.cursor * width - EDGE.left) / (width - EDGE.left - EDGE.right);
      const step = least + part * (last - least);
      for (at = first; at < rows.length - 1 && this.steps[at] < step; at++);
      draw.strokeStyle = color("faint");
      draw.setLineDash([2, 2]);
      draw.beginPath();
      draw.moveTo(x(this.steps[at]), EDGE.top);
      draw.lineTo(x(this.steps[at]), height - EDGE.bottom);
      draw.stroke();
      draw.setLineDash([]);
    }
    const value = rows[at]?.[chosen];
    const text = value === undefined ? "" : value.toFixed(chart.digits);
    if (value !== undefined) {
      draw.fillStyle = lineColor(this.race.karts[chosen].color);
      draw.beginPath();
      draw.arc(x(this.steps[at]), y(value), 3, 0, 7);
      draw.fill();
    }
    number.textContent = text;
    const name = this.race.karts[chosen]?.name ?? "";
    canvas.setAttribute("aria-label", `${chart.title} of all karts over time; ${name} now ${text}`);
  }

  range(chart, rows, first) {
    if (chart.name === "rank") return [1, Math.max(this.race.karts.length, 2)];
    let [low, high] = [chart.low ?? Infinity, chart.high ?? -Infinity];
    if (chart.high === undefined) {
      for (let n = first; n < rows.length; n++) {
        for (const value of rows[n]) {
          low = Math.min(low, value);
          high = Math.max(high, value);
        }
      }
      high = high - low < 1 ? low + 1 : high + 0.05 * (high - low);
    }
    return [low, high];
  }
}

function drawGrid(draw, { low, high, chart, width, height, y, x, least, last, step }) {
  draw.font = "10px system-ui, sans-serif";
  draw.fillStyle = color("faint");
  draw.strokeStyle = color("line");
  draw.lineWidth = 1;
  draw.textBaseline = "middle";
  draw.textAlign = "right";
  for (const value of ticks(low, high, 3, chart.name === "rank")) {
    draw.beginPath();
    draw.moveTo(EDGE.left, y(value));
    draw.lineTo(width - EDGE.right, y(value));
    draw.stroke();
    draw.fillText(String(value).replace("-", "−"), EDGE.left - 5, y(value));
  }
  draw.textBaseline = "alphabetic";
  draw.textAlign = "center";
  for (const time of ticks(least * step, last * step, 4, true)) {
    draw.fillText(`${time} s`, Math.min(Math.max(x(time / step), 44), width - 16), height - 4);
  }
}

function ticks(low, high, number, isWhole) {
  const rough = (high - low) / number;
  const power = 10 ** Math.floor(Math.log10(rough));
  let gap = [1, 2, 5, 10].map((n) => n * power).find((n) => n >= rough * 0.99);
  if (isWhole) gap = Math.max(1, Math.round(gap));
  const found = [];
  for (let n = Math.ceil(low / gap - 1e-6); n * gap <= high + 1e-9; n++) found.push(+(n * gap).toFixed(6));
  return isWhole && low === 1 && !found.includes(1) ? [1, ...found] : found;
}
