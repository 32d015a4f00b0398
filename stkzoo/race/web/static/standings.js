// Standings. Each kart keeps its row element, which moves with an animation when ranks change.

export class Standings {
  constructor(list, onChoose) {
    this.list = list;
    this.onChoose = onChoose;
    this.rows = [];
    this.isCalm = matchMedia("(prefers-reduced-motion: reduce)");
  }

  reset(race) {
    this.race = race;
    this.rows = race.karts.map((kart, k) => {
      const row = document.createElement("li");
      row.dataset.kart = k;
      const button = document.createElement("button");
      const parts = ["badge", "name", "detail", "way"].map((name) => {
        const part = document.createElement(name === "way" ? "div" : "span");
        part.className = name === "detail" ? "detail number" : name;
        button.append(part);
        return part;
      });
      const [badge, name, detail, way] = parts;
      badge.style.background = kart.color;
      badge.style.color = kart.ink;
      name.textContent = kart.name;
      const sub = document.createElement("span");
      sub.className = "sub";
      sub.textContent = ` ${kart.agent ?? "game's AI"}`;
      name.append(sub);
      const bar = document.createElement("i");
      bar.style.background = kart.color;
      way.append(bar);
      button.addEventListener("click", () => this.onChoose(k));
      row.append(button);
      return { row, button, badge, detail, bar, sub };
    });
    this.list.replaceChildren(...this.rows.map(({ row }) => row));
    this.order = "";
  }

  show(moment, chosen, outcomes) {
    const { karts } = moment;
    this.rows.forEach(({ button, badge, detail, bar, sub }, k) => {
      const { agent, name } = this.race.karts[k];
      const failure = moment.failures[agent];
      const outcome = outcomes[agent];
      const rank = outcome?.rank ?? karts.rank[k];
      badge.textContent = ordinal(rank); // plain numbers on the map are those of agents
      detail.textContent = detailOf(karts, k, outcome);
      bar.style.width = `${100 * karts.progress[k]}%`;
      button.setAttribute("aria-pressed", k === chosen);
      button.setAttribute("aria-label", `${rank}. ${name}, ${detail.textContent}`);
      button.title = failure ?? this.race.karts[k].source;
      sub.textContent = failure ? " failed" : ` ${agent ?? "game's AI"}`;
      sub.classList.toggle("failed", Boolean(failure));
    });
    const rankOf = (k) => outcomes[this.race.karts[k].agent]?.rank ?? karts.rank[k];
    const order = this.rows.map((_, k) => k).sort((a, b) => rankOf(a) - rankOf(b) || a - b);
    if (order.join() !== this.order) this.arrange(order);
    return order;
  }

  arrange(order) {
    const isFirst = this.order === "";
    this.order = order.join();
    const focused = document.activeElement;
    const before = this.rows.map(({ row }) => row.offsetTop);
    this.list.append(...order.map((k) => this.rows[k].row));
    if (this.list.contains(focused)) focused.focus();
    if (isFirst || this.isCalm.matches) return;
    this.rows.forEach(({ row }, k) => {
      const moved = before[k] - row.offsetTop;
      if (moved) row.animate([{ transform: `translateY(${moved}px)` }, { transform: "none" }], { duration: 350, easing: "ease-out" });
    });
  }
}

function ordinal(rank) {
  const ending = { 1: "st", 2: "nd", 3: "rd" }[rank % 10] ?? "th";
  return `${rank}${rank % 100 > 10 && rank % 100 < 14 ? "th" : ending}`;
}

function detailOf(karts, k, outcome) {
  if (karts.finish_time[k] > 0) return `✓ ${clock(karts.finish_time[k])}`;
  if (outcome?.status === "retired") return "retired";
  return `${karts.speed[k].toFixed(1)} m/s · ${Math.floor(100 * karts.progress[k])}%`;
}

export function clock(seconds) {
  const tenths = Math.round(Math.max(0, seconds) * 10);
  const rest = String(Math.floor(tenths / 10) % 60).padStart(2, "0");
  return `${Math.floor(tenths / 600)}:${rest}.${tenths % 10}`;
}
