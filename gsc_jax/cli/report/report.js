"use strict";
// Adds a large image of one view, sorting and keys; the page is complete without them.
{
  const strip = document.getElementById("strip");
  const stage = document.getElementById("stage");
  const frame = stage.querySelector(".frame");
  const small = document.getElementById("small");
  const sort = document.getElementById("sort");
  const radios = [...document.querySelectorAll('input[name="layer"]')];
  let view = null; // list item of the selected view

  const views = () => [...strip.children];

  // Show the thumbnail until the full image is loaded; it is missing if the page was copied alone.
  function draw() {
    const layer = radios.find((radio) => radio.checked).value;
    const shown = view.querySelector(`[data-layer="${layer}"]`).cloneNode(true);
    frame.style.aspectRatio = view.dataset.ratio;
    frame.replaceChildren(shown);
    small.hidden = true;
    if (shown.localName !== "img") return;
    const full = new Image();
    full.onload = () => (shown.src = full.src);
    full.onerror = () => (small.hidden = !shown.isConnected);
    full.src = shown.dataset.full;
  }

  function select(next) {
    const focused = view && view.contains(document.activeElement);
    if (view) view.querySelector("a").removeAttribute("aria-current");
    view = next;
    const link = view.querySelector("a");
    link.setAttribute("aria-current", "true");
    if (focused) link.focus({ preventScroll: true });
    stage.querySelector("figcaption").replaceChildren(view.querySelector(".facts").cloneNode(true));
    const order = views();
    document.getElementById("place").textContent = `${order.indexOf(view) + 1} of ${order.length}`;
    // Scroll the strip to the selected view; `scrollIntoView` would also scroll the page.
    const inner = view.getBoundingClientRect();
    const outer = strip.getBoundingClientRect();
    strip.scrollTop += Math.min(0, inner.top - outer.top) + Math.max(0, inner.bottom - outer.bottom);
    strip.scrollLeft += Math.min(0, inner.left - outer.left) + Math.max(0, inner.right - outer.right);
    draw();
  }

  function step(by) {
    const order = views();
    select(order[(order.indexOf(view) + by + order.length) % order.length]);
  }

  document.body.classList.add("live");
  stage.hidden = false;
  document.querySelector(".sort").hidden = false;
  radios.forEach((radio) => radio.addEventListener("change", draw));
  document.getElementById("previous").addEventListener("click", () => step(-1));
  document.getElementById("next").addEventListener("click", () => step(1));
  sort.addEventListener("change", () => {
    const sign = sort.value === "tampered" ? -1 : 1;
    const rank = (item) => sign * Number(item.dataset[sort.value]);
    const order = views().sort((a, b) => rank(a) - rank(b) || a.dataset.order - b.dataset.order);
    strip.replaceChildren(...order);
    select(view);
  });
  strip.addEventListener("click", (event) => {
    const link = event.target.closest("a");
    if (!link || event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    select(link.parentNode);
  });
  document.addEventListener("keydown", (event) => {
    const target = event.target;
    if (event.ctrlKey || event.altKey || event.metaKey || target.localName === "select") return;
    radios[Number(event.key) - 1]?.click();
    const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!by || target.localName === "input") return; // arrows also select a radio button
    event.preventDefault();
    step(by);
  });
  select(views()[0]); // in which the labelled Gaussians are largest
}
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((part) => (part.open = true)));
