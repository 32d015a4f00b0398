// Expandable tree of an agent's observation. Only open nodes are updated.

export class Tree {
  constructor(place) {
    this.place = place;
    this.opened = new Set(["observation"]);
    this.nodes = new Map();
  }

  reset() {
    this.nodes.clear();
    this.place.replaceChildren();
    this.say("waiting for the race");
  }

  say(text) {
    const line = document.createElement("span");
    line.className = "none";
    line.textContent = text;
    this.place.replaceChildren(line);
    this.nodes.clear();
  }

  show(parts) {
    if (!this.nodes.size) this.place.replaceChildren();
    this.fill(this.place, parts, "");
  }

  fill(place, entries, path) {
    const wanted = new Set();
    for (const [name, value] of entriesOf(entries)) {
      const here = path ? `${path}/${name}` : name;
      wanted.add(here);
      const isBranch = value !== null && typeof value === "object" && !isShort(value);
      let node = this.nodes.get(here);
      if (node && node.isBranch !== isBranch) {
        node.element.remove();
        node = null;
      }
      node ??= this.made(place, here, name, isBranch);
      node.value = value;
      this.write(node, here);
    }
    for (const [path_, node] of this.nodes) {
      if (node.element.parentNode === place && !wanted.has(path_)) {
        node.element.remove();
        this.nodes.delete(path_);
      }
    }
  }

  made(place, path, name, isBranch) {
    const element = document.createElement(isBranch ? "details" : "div");
    const node = { element, isBranch };
    if (isBranch) {
      element.innerHTML = '<summary><span class="key"></span> <span class="count"></span></summary><div class="inner"></div>';
      element.open = this.opened.has(path);
      element.addEventListener("toggle", () => {
        this.opened[element.open ? "add" : "delete"](path);
        if (element.open) this.write(node, path);
      });
    } else {
      element.className = "leaf";
      element.innerHTML = '<span class="key"></span><span class="value"></span>';
    }
    element.querySelector(".key").textContent = name;
    place.append(element);
    this.nodes.set(path, node);
    return node;
  }

  write(node, path) {
    const { element, value, isBranch } = node;
    if (!isBranch) {
      element.lastChild.textContent = textOf(value);
      return;
    }
    element.querySelector(".count").textContent = countOf(value);
    if (element.open) this.fill(element.querySelector(":scope > .inner"), value, path);
  }
}

function entriesOf(value) {
  if (Array.isArray(value)) return value.map((entry, n) => [String(n), entry]);
  return isCut(value) ? entriesOf(value.first) : Object.entries(value);
}

function isCut(value) {
  return Array.isArray(value.first) && typeof value.of === "number";
}

function isShort(value) {
  return Array.isArray(value) && value.length <= 4 && value.every((entry) => entry === null || typeof entry !== "object");
}

function countOf(value) {
  if (isCut(value)) return `first ${value.first.length} of ${value.of}`;
  const size = Array.isArray(value) ? value.length : Object.keys(value).length;
  return size ? `${size}` : "nothing now";
}

function textOf(value) {
  if (Array.isArray(value)) return value.length ? value.map(textOf).join("  ") : "none";
  if (typeof value !== "number") return String(value);
  const isTiny = value !== 0 && Math.abs(value) < 1e-3;
  const text = isTiny ? value.toExponential(1) : String(Number.isInteger(value) ? value : +value.toPrecision(4));
  return text.replaceAll("-", "−");
}
