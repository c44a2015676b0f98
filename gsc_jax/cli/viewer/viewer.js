// The page is replaced by viser's client, which draws the splats, and by a panel. The panel reaches
// the client by the objects that viser offers to its own tests: `__viserMutable` (camera, nodes of
// the scene, queue of messages), `__viserSceneTree` and `__viserTestpoints`.

const NODE = "/gaussians", SELECTED = [255, 242, 51], GREY = 0.35 /* share in the heat map */, BRUSH = 20 /* pixels */;
const json = (id) => JSON.parse(document.getElementById(id).textContent);
const decoded = async (text) => (await fetch(`data:application/octet-stream;base64,${text}`)).arrayBuffer();
const number = (value) => Number(value.toPrecision(3)).toString();

function withoutGraphicsCard() {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return null;
  const name = gl.getExtension("WEBGL_debug_renderer_info")?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER;
  return /swiftshader|llvmpipe|software|basic render/i.test(gl.getParameter(name));
}

async function becomeClient() {
  const software = withoutGraphicsCard();
  if (software === null)
    return document.body.append(
      "This browser has no WebGL 2, so the scene cannot be shown; open report.html instead.");
  const facts = json("facts"), client = json("client"), panel = document.getElementById("panel").content;
  const [scores, rows, scales] = await Promise.all(facts.arrays.map(decoded));
  const arrays = { scores: new Float32Array(scores), rows: new Uint32Array(rows), scales: new Float32Array(scales) };
  // In a page that is opened from a file, browsers refuse module workers from blobs. If a script has
  // no address as a blob, the client puts it into the address.
  const { createObjectURL } = URL;
  URL.createObjectURL = (blob) => (blob.type.includes("javascript") ? "" : createObjectURL.call(URL, blob));
  document.open();
  document.write(client);
  document.close();
  while (!(window.__viserMutable?.cameraControl && __viserMutable.nodeRefFromName[NODE]?.children.length))
    await new Promise((resolve) => setTimeout(resolve, 50));
  document.body.append(panel);
  globalThis.view = new Panel({ ...facts, ...arrays }, software);
}

class Panel {
  constructor(facts, software) {
    Object.assign(this, facts);
    this.message = __viserSceneTree.getState()[NODE].message;
    this.original = this.message.props.buffer;
    this.count = this.rows.length;
    this.selected = new Uint8Array(this.count);
    this.drawn = this.count;
    this.input("layer").addEventListener("change", () => this.paint());
    this.input("threshold").addEventListener("input", () => this.paint());
    this.input("camera").addEventListener("change", () => this.jump(0));
    this.input("previous").addEventListener("click", () => this.jump(-1));
    this.input("next").addEventListener("click", () => this.jump(1));
    this.input("clear").addEventListener("click", () => { this.selected.fill(0); this.tell(); });
    this.input("export").addEventListener("click", () => this.export());
    this.input("file").addEventListener("change", (event) => this.write(event.target.files[0]));
    document.getElementById("panel").open = innerWidth > 600;
    document.title = `${this.title} – gsc-jax`; // not that of the client
    addEventListener("pointerdown", (event) => this.press(event), true);
    this.input("software").hidden = !software || this.count <= this.few;
    if (!this.input("software").hidden) this.motion = new Motion(this);
    this.paint();
  }

  input(id) { return document.getElementById(id); }
  get threshold() { return Math.fround(this.input("threshold").valueAsNumber); } // as exact as the scores
  say(text) { this.input("message").textContent = text; }

  send(...messages) {
    __viserMutable.messageQueue.push(...messages);
    __viserMutable.requestRender();
  }

  rgba(i, layer, labelled) {
    const word = this.original[WORDS * i + COLOUR];
    let rgb = [word & 255, (word >> 8) & 255, (word >> 16) & 255];
    const mixed = (other, share) => rgb.map((value, k) => (1 - share) * value + share * other[k]);
    if (this.selected[i]) rgb = SELECTED;
    else if (layer === "result" && labelled) rgb = mixed(this.tint, this.tint_strength);
    else if (layer === "heat map") {
      rgb = Array(3).fill(rgb.reduce((sum, value, k) => sum + this.luma[k] * value, 0));
      rgb = mixed(this.heat[Math.round(255 * this.scores[i])], 1 - GREY);
    }
    const hidden = layer === (labelled ? "all but labelled" : "labelled only");
    return rgb[0] | (rgb[1] << 8) | (rgb[2] << 16) | (hidden ? 0 : (word >>> 24) << 24);
  }

  paint() {
    const { threshold } = this, layer = this.input("layer").value;
    const above = this.scores.filter((score) => score > threshold).length;
    this.input("legend").hidden = layer !== "result";
    this.input("colours").style.display = layer === "heat map" ? "" : "none";
    this.painted = this.original.slice();
    for (let i = 0; i < this.count; i++) this.painted[WORDS * i + COLOUR] = this.rgba(i, layer, this.scores[i] > threshold);
    if (this.motion) this.motion.wake(true); else this.draw(this.count);
    this.input("value").textContent = number(threshold);
    this.input("above").textContent = `${above.toLocaleString("en")} of ${this.count.toLocaleString("en")} Gaussians shown here (${((100 * above) / this.count).toFixed(1)}%) score above it.`;
  }

  draw(count) {
    this.drawn = count;
    const buffer = this.painted.slice(0, WORDS * count);
    this.send({ type: "SceneNodeUpdateMessage", name: NODE, owner: this.message.owner, updates: { buffer } });
  }

  jump(step) {
    const camera = this.input("camera"), cameras = camera.options.length;
    camera.selectedIndex = (camera.selectedIndex + step + cameras) % cameras;
    const [position, look_at, up, [fov]] = this.poses[camera.selectedIndex], initial = false;
    this.motion?.wake();
    this.send(
      { type: "SetCameraUpDirectionMessage", position: up, initial },
      { type: "SetCameraPositionMessage", position, initial },
      { type: "SetCameraLookAtMessage", look_at, initial },
      { type: "SetCameraFovMessage", fov, initial });
  }

  /** From units of viser's buffer to those of three.js. */
  matrix() {
    const { matrixWorld } = __viserMutable.nodeRefFromName[NODE];
    return matrixWorld.clone().scale(__viserMutable.camera.position.clone().setScalar(this.unit));
  }

  press(event) {
    const { canvas } = __viserMutable, drag = event.shiftKey ? "box" : this.input("drag").value;
    if (event.target !== canvas || !event.isPrimary) return;
    const box = canvas.getBoundingClientRect(), point = (e) => [e.clientX - box.left, e.clientY - box.top];
    const start = point(event);
    if (drag === "turn") return addEventListener("pointerup", (e) => {
      if (Math.hypot(point(e)[0] - start[0], point(e)[1] - start[1]) < 3) this.describe(start);
    }, { once: true });
    event.stopImmediatePropagation(); // the camera stays
    event.preventDefault();
    const places = placesOf(this.original, __viserMutable, this.matrix()), marker = this.input("drawn");
    const move = (e) => {
      const end = point(e), brush = drag === "brush";
      const stroke = [...(e.getCoalescedEvents?.() ?? []), e].map(point); // since the last event
      const [from, to] = brush ? [end.map((x) => x - BRUSH), end.map((x) => x + BRUSH)]
        : [end.map((x, k) => Math.min(x, start[k])), end.map((x, k) => Math.max(x, start[k]))];
      marker.hidden = false;
      marker.style = `left: ${from[0] + box.left}px; top: ${from[1] + box.top}px; width: ${to[0] - from[0]}px; height: ${to[1] - from[1]}px; border-radius: ${brush ? "50%" : 0}`;
      if (!brush && e.type === "pointermove") return;
      for (let i = 0; i < this.count; i++) {
        const place = [places[2 * i], places[2 * i + 1]];
        const inside = brush
          ? stroke.some(([x, y]) => Math.hypot(place[0] - x, place[1] - y) < BRUSH)
          : place.every((x, k) => x >= from[k] && x <= to[k]);
        if (inside && opacity(this.painted, i)) this.selected[i] = 1;
      }
    };
    const end = new AbortController(), options = { capture: true, signal: end.signal };
    addEventListener("pointermove", move, options);
    for (const kind of ["pointerup", "pointercancel"]) addEventListener(kind, (e) => {
      if (kind === "pointerup") move(e);
      marker.hidden = true;
      end.abort();
      this.tell();
    }, options);
  }

  tell() {
    this.paint();
    this.say(`${this.selected.reduce((sum, value) => sum + value, 0).toLocaleString("en")} Gaussians are selected.`);
  }

  describe(place) {
    const i = splatAt(this.painted, __viserMutable, this.matrix(), place);
    if (i === null) { this.say("No Gaussian is there."); return; }
    const word = this.original[WORDS * i + COLOUR], list = (values) => Array.from(values, number).join(", ");
    const facts = { row: this.rows[i].toLocaleString("en"), score: this.scores[i].toFixed(3),
      position: list(center(this.original, i).map((x) => x * this.unit)), scales: list(this.scales.subarray(3 * i, 3 * i + 3)),
      opacity: opacity(this.original, i).toFixed(2), colour: [word & 255, (word >> 8) & 255, (word >> 16) & 255].map((x) => (x / 255).toFixed(2)).join(", ") };
    facts.traces = Object.keys(this.traces).filter((name) => this.traces[name].includes(i)).join(", ") || "none";
    const table = document.createElement("table");
    for (const [name, value] of Object.entries(facts)) {
      const line = table.insertRow();
      for (const text of [name, value]) line.insertCell().textContent = text;
    }
    this.input("message").replaceChildren("The Gaussian that is seen there:", table);
  }

  async export() {
    if (this.input("part").value.endsWith("selected") && !this.selected.includes(1))
      return this.say("No Gaussian is selected; drag a box with Shift, or choose the brush.");
    // A page that is opened from a file may read no other.
    const answer = location.protocol === "file:" ? null : await fetch("tamper.ply").catch(() => null);
    const content = answer?.ok ? await answer.blob().catch(() => null) : null;
    if (content) { await this.write(content); return; }
    this.say("This page has no copy of the scene file: choose tamper.ply in the folder of these results.");
    this.input("file").value = "";
    this.input("file").click();
  }

  async write(file) {
    if (!file) return;
    try {
      const { pieces, kept } = this.part(new Uint8Array(await file.arrayBuffer()));
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob(pieces));
      link.download = `${this.title} ${this.input("part").value}.ply`.replaceAll(" ", "_");
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 60000);
      this.say(`${link.download} is written with all properties of ${kept.toLocaleString("en")} Gaussians.`);
    } catch (error) {
      this.say(error.message);
    }
  }

  /** Pieces of a file with the rows of a part: labelled by the threshold, or selected. */
  part(bytes) {
    const vertices = layout(bytes), name = this.input("part").value, chosen = new Uint8Array(vertices.count);
    if (vertices.count !== this.total || this.rows.some((row, i) => vertices.score(row) !== this.scores[i]))
      throw new Error("This is not tamper.ply of these results, or they are new; start gsc-jax view again.");
    if (name.endsWith("selected")) this.rows.forEach((row, i) => { chosen[row] = this.selected[i]; });
    else for (let row = 0; row < vertices.count; row++) chosen[row] = vertices.score(row) > this.threshold;
    return withRows(bytes, vertices, (row) => (chosen[row] === 1) === name.startsWith("only"));
  }
}

document.addEventListener("DOMContentLoaded", becomeClient);
