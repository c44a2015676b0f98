"use strict";
// Adds to a page that is complete without it: a stage for one view, sorting, keys.
{
  const strip = document.getElementById("strip");
  const stage = document.getElementById("stage");
  const frame = stage.querySelector(".frame");
  const caption = stage.querySelector("figcaption");
  const radios = [...document.querySelectorAll('input[name="layer"]')];
  const sort = document.getElementById("sort");
  const large = new Map();
  let view = null;

  const views = () => [...strip.children];
  const layer = () => radios.find((radio) => radio.checked).value;
  const layerOf = (item, name) => item.querySelector(`[data-layer="${name}"]`);

  // The large picture of a small one: it is looked for once, and may not be there.
  function largeOf(small) {
    const address = small.dataset.full;
    if (!large.has(address)) {
      const picture = new Image();
      picture.onload = () => showing(small) && draw();
      picture.onerror = () => {
        picture.missing = true;
        if (showing(small)) draw();
      };
      picture.src = address;
      large.set(address, picture);
    }
    return large.get(address);
  }

  const showing = (small) => view && layerOf(view, layer()) === small;
  const ready = (picture) => picture.complete && picture.naturalWidth > 0;

  function draw() {
    const small = layerOf(view, layer());
    frame.style.aspectRatio = view.dataset.ratio;
    document.getElementById("small").hidden = true;
    if (small.localName !== "img") {
      frame.replaceChildren(small.cloneNode(true));
      return;
    }
    const whole = largeOf(small);
    const shown = frame.querySelector("img") || new Image();
    shown.alt = small.alt;
    shown.src = ready(whole) ? whole.src : small.src;
    document.getElementById("small").hidden = !whole.missing;
    if (shown.parentNode !== frame) frame.replaceChildren(shown);
  }

  function choose(next) {
    if (view) view.querySelector("a").removeAttribute("aria-current");
    const follow = view && view.contains(document.activeElement);
    view = next;
    const link = view.querySelector("a");
    link.setAttribute("aria-current", "true");
    if (follow) link.focus({ preventScroll: true });
    caption.replaceChildren(view.querySelector(".facts").cloneNode(true));
    const order = views();
    document.getElementById("place").textContent = `${order.indexOf(view) + 1} of ${order.length}`;
    reveal();
    draw();
    // So that the other pictures of this view come at once when they are asked for.
    view.querySelectorAll("img").forEach(largeOf);
  }

  // Scrolls the strip, never the page.
  function reveal() {
    const inner = view.getBoundingClientRect();
    const outer = strip.getBoundingClientRect();
    strip.scrollTop += Math.min(0, inner.top - outer.top) + Math.max(0, inner.bottom - outer.bottom);
    strip.scrollLeft += Math.min(0, inner.left - outer.left) + Math.max(0, inner.right - outer.right);
  }

  function step(by) {
    const order = views();
    choose(order[(order.indexOf(view) + by + order.length) % order.length]);
  }

  function arrange() {
    const key = sort.value;
    const sign = key === "found" ? -1 : 1;
    const by = (item) => [sign * Number(item.dataset[key]), Number(item.dataset.order)];
    const order = views().sort((a, b) => by(a)[0] - by(b)[0] || by(a)[1] - by(b)[1]);
    strip.replaceChildren(...order);
    choose(view);
  }

  function press(event) {
    if (event.ctrlKey || event.altKey || event.metaKey || event.defaultPrevented) return;
    const where = event.target;
    const number = Number(event.key);
    if (where.localName === "select") return;
    if (radios[number - 1]) {
      radios[number - 1].checked = true;
      draw();
      return;
    }
    const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    // In a group of radio buttons the arrows choose the button, in a wide table they scroll it.
    if (!by || where.localName === "input" || (where.closest && where.closest(".scroll"))) return;
    event.preventDefault();
    step(by);
  }

  function choosePicked(event) {
    const link = event.target.closest("a");
    if (!link || event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    choose(link.parentNode);
  }

  document.body.classList.add("live");
  stage.hidden = false;
  document.querySelector(".sort").hidden = false;
  radios.forEach((radio) => radio.addEventListener("change", draw));
  document.getElementById("previous").addEventListener("click", () => step(-1));
  document.getElementById("next").addEventListener("click", () => step(1));
  sort.addEventListener("change", arrange);
  strip.addEventListener("click", choosePicked);
  document.addEventListener("keydown", press);
  window.addEventListener("beforeprint", () => {
    document.querySelectorAll("details").forEach((part) => (part.open = true));
  });
  // The view that shows most of what was found comes first.
  const most = views().reduce((a, b) => (Number(b.dataset.found) > Number(a.dataset.found) ? b : a));
  choose(most);
}
