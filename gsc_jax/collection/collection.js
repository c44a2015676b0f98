"use strict";
// Elements exist for the visible rows only; two empty rows have the height of all others.
const HEIGHT = 40, AROUND = 10;
const [ID, PROBABILITY, SHARE, GAUSSIANS, BYTES, SECONDS, TRACES, KIND, ERROR, REPORT, COPY] = Array(11).keys();
const all = JSON.parse(document.getElementById("data").textContent);
const words = all.map(row => [row[ID], row[TRACES], row[KIND], row[ERROR], row[COPY]].join(" ").toLowerCase());
const box = document.getElementById("box"), body = box.querySelector("tbody");
const filter = document.getElementById("filter"), shown = document.getElementById("shown");
let order = [], sorted = PROBABILITY, descending = true;

function cell(row, text) {
  const place = row.insertCell();
  place.textContent = place.title = text;
  return place;
}

function space(rows) {
  const row = body.insertRow();
  row.style.height = rows * HEIGHT + "px";
}

function name(row, entry) {
  const place = cell(row, entry[ID]);
  if (!entry[REPORT]) return;
  const link = document.createElement("a"), image = document.createElement("img");
  link.href = "reports/" + entry[REPORT];
  image.src = link.href.replace(/report\.html$/, "overview.png");
  image.alt = "";
  link.append(image, entry[ID]);
  place.replaceChildren(link);
}

function probability(row, entry) {
  const value = entry[PROBABILITY], place = cell(row, value === null ? "" : value.toFixed(3));
  if (value === null) return;
  const meter = document.createElement("meter");
  meter.value = value;
  place.prepend(meter);
}

function draw() {
  const first = Math.max(0, Math.floor(box.scrollTop / HEIGHT) - AROUND);
  const last = Math.min(order.length, first + Math.ceil(box.clientHeight / HEIGHT) + 2 * AROUND);
  body.replaceChildren();
  space(first);
  for (const entry of order.slice(first, last).map(index => all[index])) {
    const row = body.insertRow();
    row.className = "scene";
    name(row, entry);
    probability(row, entry);
    cell(row, entry[SHARE] === null ? "" : (100 * entry[SHARE]).toFixed(2) + " %");
    for (const column of [GAUSSIANS, BYTES]) cell(row, entry[column] === null ? "" : entry[column].toLocaleString("en"));
    cell(row, entry[SECONDS] === null ? "" : entry[SECONDS].toFixed(1));
    cell(row, entry[TRACES]);
    cell(row, entry[KIND] ? entry[KIND] + ": " + entry[ERROR] : entry[COPY] ? "copy of " + entry[COPY] : "");
  }
  space(order.length - last);
}

function compare(a, b) {
  const [x, y] = [all[a][sorted], all[b][sorted]];
  if (x === y) return a - b;
  if (x === null || x === "") return 1;  // missing values are last in both directions
  if (y === null || y === "") return -1;
  return (x < y ? -1 : 1) * (descending ? -1 : 1);
}

function update() {
  const wanted = filter.value.toLowerCase().split(/\s+/);
  order = [...all.keys()].filter(index => wanted.every(word => words[index].includes(word))).sort(compare);
  shown.textContent = order.length.toLocaleString("en") + " shown";
  for (const button of box.querySelectorAll("th button"))
    button.parentElement.ariaSort = +button.dataset.column === sorted ? (descending ? "descending" : "ascending") : "none";
  box.scrollTop = 0;
  draw();
}

for (const button of box.querySelectorAll("th button")) button.addEventListener("click", () => {
  const column = +button.dataset.column;
  descending = column === sorted ? !descending : ![ID, TRACES, KIND].includes(column);
  sorted = column;
  update();
});
for (const button of document.querySelectorAll("[data-filter]")) button.addEventListener("click", () => {
  filter.value = button.dataset.filter;
  update();
});
filter.addEventListener("input", update);
box.addEventListener("scroll", draw);
window.addEventListener("resize", draw);
update();
