// The page: receives messages, stores the current state, draws it, and sends commands.

import { Charts } from "./charts.js";
import { Link } from "./link.js";
import { RaceMap } from "./map.js";
import { clock, Standings } from "./standings.js";
import { Tree } from "./tree.js";

const find = (id) => document.getElementById(id);
const WORDS = { running: "running", paused: "paused", stopping: "stopping", over: "over", lost: "not connected" };
const ENDINGS = {
  finished: "The race is over.",
  stopped: "The race was stopped.",
  interrupted: "The race was interrupted.",
};

const now = { race: null, moment: null, state: { mode: "lost", speed: 1 }, maySteer: false, chosen: 0, outcomes: {}, leader: -1 };
const map = new RaceMap(find("map"));
const charts = new Charts(find("charts"));
const standings = new Standings(find("standings"), choose);
const tree = new Tree(find("tree"));
const link = new Link({ onMessage: take, onLost: lose });

// ---------------------------------------------------------------- incoming messages

const TAKERS = {
  hello: ({ may_steer }) => (now.maySteer = may_steer),
  race: takeRace,
  state: takeState,
  moment: takeMoment,
  traces: (message) => charts.add(message),
  observation: ({ agent, parts }) => agent === now.race?.karts[now.chosen]?.agent && tree.show(parts),
  result: takeResult,
  error: ({ text }) => notice(text, true),
  bye: () => {},
};

function take(message) {
  TAKERS[message.type]?.(message);
}

function takeRace(race) {
  const isSame = JSON.stringify(race.karts) === JSON.stringify(now.race?.karts); // a new connection
  Object.assign(now, { race, moment: null, outcomes: {}, leader: -1 });
  if (!isSame) now.chosen = Math.max(0, race.karts.findIndex((kart) => kart.agent === "kart_0"));
  find("title").textContent = race.title;
  document.title = `${race.title} · stkzoo`;
  const laps = race.laps === 1 ? "1 lap" : `${race.laps} laps`;
  const seed = race.seed === null ? "" : ` · seed ${race.seed}`;
  find("subtitle").textContent = `${laps} · ${race.length.toFixed(0)} m · ${race.karts.length} karts${seed}`;
  notice("");
  map.reset(race);
  charts.reset(race);
  standings.reset(race);
  fillAgents(race);
  choose(now.chosen);
}

function takeState(state) {
  now.state = state;
  showState();
}

function takeMoment(moment) {
  now.moment = moment;
  map.add(moment, performance.now());
  charts.isStale = true;
  find("clock").textContent = clock(moment.time);
  find("steps").textContent = `step ${moment.steps}`;
  const order = standings.show(moment, now.chosen, now.outcomes);
  tellLeader(order[0]);
  const { laps } = now.race;
  find("laps").textContent = laps > 1 ? `lap ${moment.karts.lap[order[0]]} of ${laps}` : "";
  showFacts();
}

function takeResult({ result }) {
  now.outcomes = Object.fromEntries(result.agents.map((row) => [row.agent, row]));
  const order = now.moment ? standings.show(now.moment, now.chosen, now.outcomes) : [];
  const winner = now.race?.karts[order[0]]?.name ?? "";
  const text = ENDINGS[result.status] ?? `The race was cut short (${result.status.replaceAll("_", " ")}).`;
  const lead = result.agents.some((row) => row.finish_time !== null) ? "won" : "was ahead";
  notice(`${text} ${winner} ${lead}; ${result.steps} steps, countdown included.`);
}

function lose() {
  now.state = { ...now.state, mode: now.state.mode === "over" ? "over" : "lost" };
  now.maySteer = false;
  showState();
}

// ---------------------------------------------------------------- display

function showState() {
  const { mode, speed } = now.state;
  const isRacing = mode === "running" || mode === "paused";
  const pill = find("mode");
  pill.textContent = isRacing && !now.maySteer ? `${WORDS[mode]}, watching` : WORDS[mode];
  pill.dataset.mode = mode;
  const run = find("run");
  run.dataset.does = mode === "running" ? "pause" : "run";
  run.querySelector(".word").textContent = mode === "running" ? "Pause" : "Run";
  run.title = mode === "running" ? "pause the race (space)" : "let the race run (space)";
  for (const button of document.querySelectorAll(".controls button")) {
    button.disabled = !(isRacing && now.maySteer);
  }
  find("stop").disabled = !(now.maySteer && (isRacing || mode === "over"));
  find("stop").textContent = mode === "over" ? "Close" : "Stop";
  for (const button of document.querySelectorAll("[data-speed]")) {
    button.setAttribute("aria-pressed", button.dataset.speed === String(speed ?? "max"));
  }
}

function notice(text, isBad = false) {
  const place = find("notice");
  place.textContent = text;
  place.hidden = !text;
  place.classList.toggle("bad", isBad);
}

function tellLeader(leader) {
  if (leader !== now.leader && now.moment.steps > 0) {
    find("news").textContent = `${now.race.karts[leader].name} leads`;
    find("map").setAttribute("aria-label", `map of the track; ${now.race.karts[leader].name} leads`);
  }
  now.leader = leader;
}

function fillAgents(race) {
  const place = (k) => (race.karts[k].agent === null ? Infinity : Number(race.karts[k].agent.split("_")[1]));
  const order = [...race.karts.keys()].sort((a, b) => (place(a) > place(b)) - (place(a) < place(b)));
  const options = order.map((k) => new Option(`${race.karts[k].agent ?? "game"} · ${race.karts[k].name}`, k));
  find("agent").replaceChildren(...options);
}

function choose(k) {
  now.chosen = k;
  find("agent").value = k;
  const { agent } = now.race.karts[k];
  tree.reset();
  if (agent === null) tree.say("the game drives this kart and sees no observation");
  link.send({ type: "watch", agent });
  charts.isStale = true;
  if (now.moment) {
    standings.show(now.moment, k, now.outcomes);
    showFacts();
  }
}

function showFacts() {
  const { karts } = now.moment;
  const k = now.chosen;
  const finish = karts.finish_time[k];
  const facts = {
    rank: now.outcomes[now.race.karts[k].agent]?.rank ?? karts.rank[k],
    speed: `${karts.speed[k].toFixed(1)} m/s`,
    distance: `${karts.distance[k].toFixed(0)} m`,
    reward: karts.reward[k].toFixed(1),
    nitro: karts.nitro[k].toFixed(1),
    powerup: now.race.powerups[karts.powerup[k]] ?? karts.powerup[k],
    ...(finish > 0 ? { finish: clock(finish) } : {}),
  };
  const place = find("facts");
  const names = Object.keys(facts);
  if (place.dataset.names !== names.join()) {
    place.dataset.names = names.join();
    place.replaceChildren(...names.map((name) => {
      const pair = document.createElement("div");
      pair.append(document.createElement("dt"), document.createElement("dd"));
      pair.firstChild.textContent = name;
      return pair;
    }));
  }
  names.forEach((name, n) => (place.children[n].lastChild.textContent = facts[name]));
  showButtons(karts.buttons[k]);
}

function showButtons(pressed) {
  const place = find("buttons");
  if (place.childElementCount !== now.race.buttons.length) {
    place.replaceChildren(...now.race.buttons.map((name) => {
      const chip = document.createElement("span");
      chip.textContent = name;
      return chip;
    }));
  }
  pressed.forEach((isOn, n) => place.children[n].classList.toggle("on", Boolean(isOn)));
}

const drawn = { map: 0, charts: 0 };
function frame(time) {
  if (map.isMoving || time - drawn.map > 250) {
    map.draw(time, now.chosen);
    drawn.map = time;
  }
  if (charts.isStale && time - drawn.charts > 60) {
    charts.draw(now.chosen);
    drawn.charts = time;
  }
  requestAnimationFrame(frame);
}
requestAnimationFrame(frame);
addEventListener("resize", () => (charts.isStale = true));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => (charts.isStale = true));

// ---------------------------------------------------------------- user input

function press(selector, function_) {
  for (const button of document.querySelectorAll(selector)) {
    button.addEventListener("click", (event) => {
      function_(button);
      if (event.detail) button.blur(); // so that the page, not the button, gets the next key
    });
  }
}

function pressed(selector, isOn) {
  for (const button of document.querySelectorAll(selector)) button.setAttribute("aria-pressed", isOn(button));
}

function setMap(follows) {
  map.follows = follows;
  pressed("[data-map]", (button) => (button.dataset.map === "follow") === follows);
}

function setSpan(showsAll) {
  charts.showsAll = showsAll;
  charts.isStale = true;
  pressed("[data-span]", (button) => (button.dataset.span === "all") === showsAll);
}

function setSpeed(name) {
  link.send({ type: "speed", value: name === "max" ? null : Number(name) });
}

const toggle = () => link.send({ type: now.state.mode === "running" ? "pause" : "run" });
press("#run", toggle);
press("#step", () => link.send({ type: "step" }));
press("#stop", () => link.send({ type: "stop" }));
press("[data-speed]", (button) => setSpeed(button.dataset.speed));
press("[data-map]", (button) => setMap(button.dataset.map === "follow"));
press("[data-span]", (button) => setSpan(button.dataset.span === "all"));
find("agent").addEventListener("change", (event) => choose(Number(event.target.value)));

const other = (by) => now.race && choose((now.chosen + by + now.race.karts.length) % now.race.karts.length);
const KEYS = {
  " ": () => find("run").disabled || toggle(),
  ".": () => find("step").disabled || link.send({ type: "step" }),
  1: () => setSpeed("1"),
  2: () => setSpeed("2"),
  4: () => setSpeed("4"),
  0: () => setSpeed("max"),
  n: () => other(1),
  p: () => other(-1),
  m: () => setMap(!map.follows),
  t: () => setSpan(!charts.showsAll),
};
addEventListener("keydown", (event) => {
  const isPlain = !(event.ctrlKey || event.metaKey || event.altKey);
  const isElsewhere = event.target.matches("select, input, summary") || (event.key === " " && event.target.matches("button:not(#run)"));
  if (!isPlain || isElsewhere || !(event.key in KEYS)) return;
  event.preventDefault();
  if ("1240".includes(event.key) && document.querySelector("[data-speed]").disabled) return;
  KEYS[event.key]();
});
