"use strict";
// Without a graphics card, a frame takes 0.1 s with 10,000 splats and 1.4 s with 250,000, and the
// client of viser draws frames all the time. So the first splats, which are those that matter most,
// are drawn while the camera moves. When it rests, all are drawn in a single frame.

const REST = 400, TICK = 50, SORTED = 5000; // milliseconds

class Motion {
  constructor(panel, few) {
    Object.assign(this, { panel, few, turn: 0, pressed: false, moved: performance.now(), camera: "" });
    __viserTestpoints.devSettings.set({ fixedDpr: 0.5 }); // pixels of the canvas for one of the page
    for (const kind of ["pointerdown", "wheel", "keydown", "resize"])
      addEventListener(kind, (event) => {
        if (kind === "resize" || !document.getElementById("panel").contains(event.target)) this.wake();
        this.pressed ||= kind === "pointerdown";
      }, true);
    for (const kind of ["pointerup", "pointercancel"]) addEventListener(kind, () => { this.pressed = false; }, true);
    setInterval(() => this.look(), TICK);
  }

  /** The drawing loop of the client, which belongs to react-three-fiber. */
  get loop() { return __viserMutable.scene.__r3f.root.getState(); }

  look() {
    const camera = __viserMutable.camera.matrixWorld.elements.join(), now = performance.now();
    if (camera !== this.camera || this.pressed) Object.assign(this, { camera, moved: now });
    else if (now - this.moved > REST && this.panel.drawn !== this.panel.wanted()) this.show(this.panel.wanted());
  }

  /** Draw few splats; also those that are drawn already if they `changed`. */
  wake(changed = false) {
    this.moved = performance.now();
    if (changed || this.panel.drawn !== this.few) this.show(this.few);
  }

  async show(count) {
    const turn = ++this.turn, start = performance.now();
    this.loop.setFrameloop("never");
    this.panel.draw(count);
    __viserMutable.drainMessageQueue();
    while (!this.sorted(count) && performance.now() - start < SORTED) await new Promise((go) => setTimeout(go, TICK));
    if (turn !== this.turn) return; // something has happened since
    if (count === this.few) this.loop.setFrameloop("demand");
    else this.loop.advance(performance.now(), true);
    this.shown = count;
  }

  /** Whether the client has sorted so many splats by depth; before that, it draws one again and again. */
  sorted(count) {
    let order = [];
    __viserMutable.scene.traverse((node) => { order = node.geometry?.attributes?.sortedIndex?.array ?? order; });
    return order.length === count && order[0] !== order[count - 1];
  }
}
