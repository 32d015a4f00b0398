// Top-down map of the race, with x to the right and z up.

import { color, fitted, mixed } from "./theme.js";

const FOLLOWED = 110; // [m], width of the map section when it follows a kart
const TRAIL = 25; // moments
const LEAP = 12; // [m], a few times this in one update is a jump, which is not interpolated
const ITEMS = {
  0: ["#d98a00", "square"],
  1: ["#b8a000", "disc"],
  2: ["#0a8fb0", "disc"],
  3: ["#0a8fb0", "dot"],
  4: ["#c2488a", "disc"],
  6: ["#5a8f2a", "disc"],
};

export class RaceMap {
  constructor(canvas) {
    this.canvas = canvas;
    this.follows = false;
    this.reset(null);
  }

  reset(race) {
    this.race = race;
    this.before = this.after = null;
    this.trail = [];
    if (race) this.road = roadPaths(race.road);
  }

  add(moment, now) {
    const isNext = this.after && moment.steps > this.after.steps;
    const gap = isNext ? now - this.since : 0;
    this.before = isNext ? this.shown(now) : moment.karts;
    this.duration = Math.min(gap, 250);
    this.since = now;
    this.after = moment;
    this.trail.push(moment.karts);
    if (this.trail.length > TRAIL) this.trail.shift();
  }

  get isMoving() {
    return this.after && performance.now() < this.since + this.duration + 50;
  }

  // Returns the karts with positions interpolated between the last two updates.
  shown(now) {
    const { before, after } = this;
    // A frame may be older than the last update.
    const passed = Math.max(now - this.since, 0);
    const part = this.duration > 0 ? Math.min(passed / this.duration, 1) : 1;
    const end = after.karts;
    if (part >= 1) return end;
    const between = (name) => end[name].map((value, k) => {
      const leapt = Math.hypot(end.x[k] - before.x[k], end.z[k] - before.z[k]) > LEAP * 2;
      return leapt ? value : before[name][k] + part * (value - before[name][k]);
    });
    const way = end.way.map((value, k) => before.way[k] + part * turn(value - before.way[k]));
    return { ...end, x: between("x"), z: between("z"), way };
  }

  draw(now, chosen) {
    const { draw, width, height } = fitted(this.canvas);
    if (!this.race || !this.after) return;
    const karts = this.shown(now);
    const view = this.view(width, height, karts, chosen);
    const at = (x, z) => [width / 2 + (x - view.x) * view.scale, height / 2 - (z - view.z) * view.scale];
    this.drawRoad(draw, width, height, view);
    this.drawItems(draw, at, view.scale);
    this.drawTrails(draw, at);
    const order = [...karts.rank.keys()].sort((a, b) => karts.rank[b] - karts.rank[a]);
    const radius = Math.max(1.5 * view.scale, 8);
    for (const k of order) this.drawKart(draw, at(karts.x[k], karts.z[k]), karts.way[k], k, radius, k === chosen);
  }

  view(width, height, karts, chosen) {
    if (this.follows && chosen >= 0) {
      return { scale: Math.max(width, height) / FOLLOWED, x: karts.x[chosen], z: karts.z[chosen] };
    }
    const { low, high } = this.race.road;
    const room = 0.9 * Math.min(width / Math.max(high[0] - low[0], 1), height / Math.max(high[1] - low[1], 1));
    return { scale: room, x: (low[0] + high[0]) / 2, z: (low[1] + high[1]) / 2 };
  }

  drawRoad(draw, width, height, { scale, x, z }) {
    draw.save();
    draw.translate(width / 2, height / 2);
    draw.scale(scale, -scale);
    draw.translate(-x, -z);
    draw.lineJoin = "round";
    draw.lineWidth = Math.max(3 / scale, 0.7);
    draw.strokeStyle = color("kerb");
    for (const { path } of this.road) draw.stroke(path);
    draw.lineWidth = 0.6 / scale;
    for (const { path, shade } of this.road) {
      draw.fillStyle = draw.strokeStyle = mixed(color("road-low"), color("road-high"), shade);
      draw.fill(path);
      draw.stroke(path);
    }
    drawStart(draw, this.race.road, scale);
    draw.restore();
  }

  drawItems(draw, at, scale) {
    for (const [x, z, kind] of this.after.items) {
      const [ink, form] = ITEMS[kind] ?? ["#888888", "dot"];
      const [left, top] = at(x, z);
      const size = Math.max((form === "dot" ? 0.8 : 1.3) * scale, form === "dot" ? 1.6 : 2.4);
      draw.fillStyle = ink;
      draw.beginPath();
      if (form === "square") draw.rect(left - size, top - size, 2 * size, 2 * size);
      else draw.arc(left, top, size, 0, 7);
      draw.fill();
    }
  }

  drawTrails(draw, at) {
    draw.lineWidth = 3;
    draw.lineCap = "round";
    this.race.karts.forEach((kart, k) => {
      draw.strokeStyle = kart.color;
      for (let n = 1; n < this.trail.length; n++) {
        const [a, b] = [this.trail[n - 1], this.trail[n]];
        if (Math.hypot(a.x[k] - b.x[k], a.z[k] - b.z[k]) > 3 * LEAP) continue;
        draw.globalAlpha = (0.75 * n) / TRAIL;
        draw.beginPath();
        draw.moveTo(...at(a.x[k], a.z[k]));
        draw.lineTo(...at(b.x[k], b.z[k]));
        draw.stroke();
      }
    });
    draw.globalAlpha = 1;
  }

  drawKart(draw, [x, y], way, k, radius, isChosen) {
    const kart = this.race.karts[k];
    draw.save();
    draw.translate(x, y);
    if (isChosen) {
      draw.beginPath();
      draw.arc(0, 0, radius * 2.1, 0, 7);
      draw.lineWidth = 2;
      draw.strokeStyle = color("text");
      draw.stroke();
    }
    draw.rotate(way);
    draw.beginPath();
    draw.arc(0, 0, radius, -0.25, Math.PI + 0.25);
    draw.lineTo(0, -radius * 2);
    draw.closePath();
    draw.lineWidth = 4;
    draw.lineJoin = "round";
    draw.strokeStyle = color("rim");
    draw.stroke();
    draw.fillStyle = kart.color;
    draw.fill();
    draw.rotate(-way);
    draw.fillStyle = kart.ink;
    draw.font = `700 ${Math.round(radius * 1.25)}px system-ui, sans-serif`;
    draw.textAlign = "center";
    draw.textBaseline = "middle";
    draw.fillText(kart.label, 0, 0.5);
    draw.restore();
  }
}

function roadPaths(road) {
  return road.quads.map((quad, n) => {
    const path = new Path2D();
    path.moveTo(quad[0], quad[1]);
    for (let at = 2; at < 8; at += 2) path.lineTo(quad[at], quad[at + 1]);
    path.closePath();
    const [x, z] = road.joints[n];
    const radius = road.widths[n] / 2;
    path.moveTo(x + radius, z);
    path.arc(x, z, radius, 0, 7);
    return { path, shade: road.shades[n] };
  });
}

function drawStart(draw, { line, forward }, scale) {
  const [[x, z], [endX, endZ]] = line;
  const deep = Math.max(1.2, 3 / scale);
  const squares = Math.max(4, Math.round(Math.hypot(endX - x, endZ - z) / deep));
  const [across, up] = [(endX - x) / squares, (endZ - z) / squares];
  for (let row = 0; row < 2; row++) {
    for (let n = 0; n < squares; n++) {
      const left = x + n * across + (row - 1) * deep * forward[0];
      const low = z + n * up + (row - 1) * deep * forward[1];
      draw.fillStyle = (row + n) % 2 ? "#f4f4f4" : "#181818";
      draw.beginPath();
      draw.moveTo(left, low);
      draw.lineTo(left + across, low + up);
      draw.lineTo(left + across + deep * forward[0], low + up + deep * forward[1]);
      draw.lineTo(left + deep * forward[0], low + deep * forward[1]);
      draw.fill();
    }
  }
}

function turn(angle) {
  return Math.atan2(Math.sin(angle), Math.cos(angle));
}
