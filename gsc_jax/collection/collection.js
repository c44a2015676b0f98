"use strict";
// Elements exist for the visible rows only; two empty rows have the height of all others.
const HEIGHT = 40, AROUND = 10;
const [ID, PROBABILITY, SHARE, GAUSSIANS, BYTES, SECONDS, TRACES, KIND, ERROR, REPORT, COPY, OUTCOME] = Array(12).keys();
const all = JSON.parse(document.getElementById("data").textContent);
const words = all.map(row => [row[ID], "outcome:" + row[OUTCOME], row[TRACES], row[KIND], row[ERROR], row[COPY]].join(" ").toLowerCase());
const box = document.getElementById("box"), body = box.querySelector("tbody");
const filter = document.getElementById("filter"), shown = document.getElementById("shown");
let order = [], sorted = PROBABILITY, descending = true;

const fixed = (value, digits) => value?.toFixed(digits) ?? "";
const whole = value => value?.toLocaleString("en") ?? "";

// The columns of the table; a missing value is null and has no text.
function texts(entry) {
  const labelled = entry[SHARE] === null ? "" : fixed(100 * entry[SHARE], 2) + " %";
  const error = entry[KIND] ? entry[KIND] + ": " + entry[ERROR] : entry[COPY] ? "copy of " + entry[COPY] : "";
  const numbers = [whole(entry[GAUSSIANS]), whole(entry[BYTES]), fixed(entry[SECONDS], 1)];
  const probability = `${fixed(entry[PROBABILITY], 3)} ${entry[OUTCOME] ?? ""}`.trim();
  return [entry[ID], probability, labelled, ...numbers, entry[TRACES] ?? "", error];
}

function link(entry) {
  const made = document.createElement("a"), image = document.createElement("img");
  made.href = "reports/" + entry[REPORT];
  image.src = made.href.replace(/report\.html$/, "overview.png");
  image.alt = "";
  made.append(image, entry[ID]);
  return made;
}

function draw() {
  const first = Math.max(0, Math.floor(box.scrollTop / HEIGHT) - AROUND);
  const last = Math.min(order.length, first + Math.ceil(innerHeight / HEIGHT) + 2 * AROUND);
  body.replaceChildren();
  body.insertRow().style.height = first * HEIGHT + "px";
  for (const entry of order.slice(first, last).map(index => all[index])) {
    const row = body.insertRow();
    row.className = "scene";
    for (const text of texts(entry)) Object.assign(row.insertCell(), { textContent: text, title: text });
    if (entry[REPORT]) row.cells[0].replaceChildren(link(entry));
    const meter = { value: entry[PROBABILITY] };
    if (meter.value !== null) row.cells[1].prepend(Object.assign(document.createElement("meter"), meter));
  }
  body.insertRow().style.height = (order.length - last) * HEIGHT + "px";
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
