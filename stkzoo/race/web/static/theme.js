// The page's colors for canvases, and line colors with enough contrast in both color schemes.

const isDark = matchMedia("(prefers-color-scheme: dark)");
let known = {};
isDark.addEventListener("change", () => (known = {}));

export function color(name) {
  known[name] ??= getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  return known[name];
}

export function rgb(hex) {
  return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
}

export function mixed(one, other, part) {
  const ends = [rgb(one), rgb(other)];
  const parts = ends[0].map((value, at) => Math.round(value + part * (ends[1][at] - value)));
  return `rgb(${parts.join(" ")})`;
}

function luminance(hex) {
  const [r, g, b] = rgb(hex).map((value) => {
    const part = value / 255;
    return part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
  });
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

// Returns the color, darkened on a light ground or lightened on a dark one to enough contrast.
export function lineColor(hex) {
  const key = `line ${hex}`;
  if (known[key]) return known[key];
  const ground = luminance(color("sunk"));
  const away = isDark.matches ? "#ffffff" : "#000000";
  for (let part = 0; part <= 0.7; part += 0.1) {
    const values = rgb(hex).map((value, at) => Math.round(value + part * (rgb(away)[at] - value)));
    const now = `#${values.map((value) => value.toString(16).padStart(2, "0")).join("")}`;
    const [low, high] = [luminance(now), ground].sort((a, b) => a - b);
    known[key] = now;
    if ((high + 0.05) / (low + 0.05) >= 2.6) break;
  }
  return known[key];
}

// Returns a canvas's drawing context at the screen's resolution, with CSS pixels as the unit.
export function fitted(canvas) {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const [across, down] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== across || canvas.height !== down) {
    canvas.width = across;
    canvas.height = down;
  }
  const draw = canvas.getContext("2d");
  draw.setTransform(ratio, 0, 0, ratio, 0, 0);
  draw.clearRect(0, 0, width, height);
  return { draw, width, height };
}
