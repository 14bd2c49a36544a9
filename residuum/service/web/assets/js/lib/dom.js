// Elements without markup strings: whatever comes from outside only ever becomes text.

export function h(tag, attributes = {}, ...children) {
  const element = tag.startsWith("svg:")
    ? document.createElementNS("http://www.w3.org/2000/svg", tag.slice(4))
    : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "style") Object.assign(element.style, value);
    else if (name === "value") element.value = value;
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  append(element, children);
  return element;
}

function append(element, children) {
  for (const child of children.flat(Infinity)) {
    if (child === null || child === undefined || child === false) continue;
    element.append(child instanceof Node ? child : document.createTextNode(String(child)));
  }
}

// Where places are scrolled to, as they tell it: asked for it while a page changes, a browser lays out the whole page at once.
const scrolledTo = new WeakMap();
document.addEventListener("scroll", ({ target }) => scrolledTo.set(target, target.scrollTop), true);

// Replace what a place shows, and keep the keyboard where it was (elements are found again by data-key).
export function show(place, ...children) {
  const key = place.contains(document.activeElement) ? document.activeElement.dataset.key : undefined;
  const scrolled = scrolledTo.get(place);
  place.replaceChildren();
  append(place, children);
  if (scrolled) place.scrollTop = scrolled;
  if (key)
    [...place.querySelectorAll("[data-key]")].find((element) => element.dataset.key === key)?.focus({ preventScroll: true });
}

// Draw a place that changes by itself. While something in it is pressed the drawing waits: a click is a press and a release on
// one and the same element, and would be lost if that were exchanged in between.
let pressed = null;
const waiting = new Map();

export function refresh(place, content) {
  if (pressed && place.contains(pressed)) return waiting.set(place, content);
  waiting.delete(place);
  return show(place, content());
}

function release() {
  pressed = null;
  const due = [...waiting];
  waiting.clear();
  for (const [place, content] of due) if (place.isConnected) refresh(place, content);
}

const press = (event) => {
  pressed = event.target;
};
const afterTheClick = () => setTimeout(release);
document.addEventListener("pointerdown", press, true);
document.addEventListener(
  "keydown",
  (event) => {
    if (event.key === " ") press(event);
  },
  true,
);
for (const kind of ["pointerup", "pointercancel", "keyup"]) document.addEventListener(kind, afterTheClick, true);
window.addEventListener("blur", afterTheClick);

// A handler that is not begun again while its work is under way: pressing twice sends once.
export function once(work) {
  let busy = false;
  return async (event) => {
    event?.preventDefault?.();
    if (busy) return;
    busy = true;
    try {
      await work(event);
    } finally {
      busy = false;
    }
  };
}

// Scroll a strip sideways until the chosen one of its children is in the middle, as far as it goes.
export function reveal(strip, child) {
  if (child && strip.scrollWidth > strip.clientWidth)
    strip.scrollLeft = child.offsetLeft - strip.offsetLeft - (strip.clientWidth - child.offsetWidth) / 2;
}

export function panel(title, aside, ...body) {
  return h(
    "section",
    { class: "panel" },
    h("header", {}, h("h2", {}, title), aside ? h("div", { class: "aside" }, aside) : null),
    h("div", { class: "body" }, ...body),
  );
}

// A message says what failed; once something that was asked for has succeeded it is out of date.
document.addEventListener("succeeded", () => document.getElementById("notices").replaceChildren());

export function notify(text) {
  const notices = document.getElementById("notices");
  for (const same of [...notices.children].filter((each) => each.dataset.says === text)) same.remove();
  const notice = h(
    "div",
    { class: "notice", "data-says": text },
    h("p", {}, text),
    h("button", { class: "quiet", type: "button", onclick: () => notice.remove() }, "Close"),
  );
  notices.append(notice);
  setTimeout(() => notice.remove(), 12000);
}
