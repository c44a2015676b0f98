// Without a graphics card, a frame takes 0.1 s with 10,000 splats and 1.4 s with 250,000 (by hand).
// So the first splats, which matter most, are drawn while the camera moves, and all of them in a single
// frame when it rests; viser alone would draw frames all the time.

const REST = 400, TICK = 50, SORTED = 5000; // milliseconds

class Motion {
  constructor(panel) {
    Object.assign(this, { panel, few: panel.few, all: panel.count, turn: 0, pressed: false, moved: performance.now(), camera: "" });
    __viserTestpoints.devSettings.set({ fixedDpr: 0.5 }); // pixels of the canvas for one of the page
    for (const kind of ["pointerdown", "wheel", "keydown", "resize"])
      addEventListener(kind, (event) => {
        if (kind !== "resize" && document.getElementById("panel").contains(event.target)) return;
        this.pressed ||= kind === "pointerdown";
        this.wake();
      }, true);
    for (const kind of ["pointerup", "pointercancel"]) addEventListener(kind, () => { this.pressed = false; }, true);
    setInterval(() => this.look(), TICK);
  }

  get loop() { return __viserMutable.scene.__r3f.root.getState(); } // of react-three-fiber, which draws
  look() {
    const camera = __viserMutable.camera.matrixWorld.elements.join(), still = performance.now() - this.moved;
    if (camera !== this.camera || this.pressed) {
      this.camera = camera;
      this.wake(); // also if the frame of all splats has moved it: their order is that of before
    } else if (still > REST && this.panel.drawn !== this.all) this.show(this.all);
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
    while (turn === this.turn && !this.sorted(count) && performance.now() - start < SORTED)
      await new Promise((go) => setTimeout(go, TICK));
    if (turn !== this.turn) return; // something has happened since
    if (count === this.few) this.loop.setFrameloop("demand");
    else this.loop.advance(TICK / 1000, true); // seconds
    this.shown = count;
  }

  /** Whether the client has sorted so many splats by depth; before that, it draws one again and again. */
  sorted(count) {
    let order = [];
    __viserMutable.scene.traverse((node) => { order = node.geometry?.attributes?.sortedIndex?.array ?? order; });
    return order.length === count && order[0] !== order[count - 1];
  }
}
