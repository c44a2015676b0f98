// The toolbar of the standalone page. It sends viser's client the messages that a server would.
(() => {
  "use strict";
  const SPLATS = "/gaussians";
  const CAMERAS = "/cameras";
  const WORDS = 8; // 32 bits each, per Gaussian; the last: red, green, blue, opacity
  const PATIENCE = 30000; // milliseconds

  const told = JSON.parse(document.getElementById("gsc-told").textContent);
  const scores = new Float32Array(
    Uint8Array.from(atob(told.scores), (letter) => letter.charCodeAt(0)).buffer,
  );
  const part = (name) => document.getElementById(`gsc-${name}`);
  let own = null; // the buffer in the scene's own colours

  function send(...messages) {
    const viewer = window.__viserMutable;
    messages.forEach((message) => viewer.messageQueue.push({ owner: "", ...message }));
    viewer.requestRender();
  }

  function heatOf(score, red, green, blue) {
    const color = told.colors[Math.min(told.colors.length - 1, Math.floor(score * told.colors.length))];
    const grey = told.luma[0] * red + told.luma[1] * green + told.luma[2] * blue;
    return color.map((channel) => Math.floor((1 - told.shade) * channel + told.shade * grey));
  }

  function painted(mode, threshold) {
    const buffer = own.slice();
    const bytes = new Uint8Array(buffer.buffer);
    scores.forEach((score, index) => {
      const at = 4 * (WORDS * index + WORDS - 1);
      if (mode === "heat map") {
        bytes.set(heatOf(score, bytes[at], bytes[at + 1], bytes[at + 2]), at);
      } else if (mode !== "original" && score > threshold !== (mode === "tampered only")) {
        bytes[at + 3] = 0;
      }
    });
    return buffer;
  }

  function paint() {
    const mode = document.querySelector("input[name=gsc-mode]:checked").value;
    const buffer = painted(mode, Math.fround(part("threshold").value));
    send({ type: "SceneNodeUpdateMessage", name: SPLATS, updates: { buffer } });
  }

  // A share for people, in the words of the report.
  function shareOf(part) {
    if (part > 0 && part < 0.0005) return "<0.1%";
    if (part >= 0.9995 && part < 1) return ">99.9%";
    return part === 0 || part === 1 ? `${100 * part}%` : `${(100 * part).toFixed(1)}%`;
  }

  function count() {
    const threshold = Math.fround(part("threshold").value);
    const found = scores.reduce((sum, score) => sum + (score > threshold), 0);
    const share = shareOf(found / scores.length);
    const [some, all] = [found, scores.length].map((number) => number.toLocaleString("en-US"));
    part("value").value = Number(part("threshold").value).toFixed(3);
    part("count").textContent = `${some} of ${all} Gaussians (${share}) score above it.`;
  }

  function lookFrom(pose) {
    send(
      { type: "SetCameraUpDirectionMessage", position: pose.up, initial: false },
      { type: "SetCameraPositionMessage", position: pose.position, initial: false },
      { type: "SetCameraLookAtMessage", look_at: pose.look_at, initial: false },
      { type: "SetCameraFovMessage", fov: pose.fov, initial: false },
    );
  }

  function step(by) {
    const camera = part("camera");
    camera.selectedIndex = (camera.selectedIndex + by + told.poses.length) % told.poses.length;
    lookFrom(told.poses[camera.selectedIndex]);
  }

  function listen() {
    part("modes").addEventListener("change", paint);
    part("threshold").addEventListener("input", () => {
      count();
      if (document.querySelector("input[name=gsc-mode]:checked").value.endsWith("only")) paint();
    });
    part("background").addEventListener("input", (event) => {
      window.__viserMutable.canvas.parentElement.style.background = event.target.value;
    });
    part("camera").addEventListener("change", () => step(0));
    part("previous").addEventListener("click", () => step(-1));
    part("next").addEventListener("click", () => step(1));
    part("cameras").addEventListener("change", (event) => {
      const visible = event.target.checked;
      send({ type: "SetSceneNodeVisibilityMessage", name: CAMERAS, visible });
    });
  }

  function begin(since) {
    const buffer = window.__viserSceneTree?.getState()[SPLATS]?.message.props.buffer;
    if (buffer instanceof Uint32Array && buffer.length === WORDS * scores.length) {
      own = buffer.slice();
      listen();
      part("trouble").hidden = true;
      part("controls").disabled = false;
    } else if (performance.now() - since > PATIENCE) {
      part("trouble").textContent =
        "The controls do not fit this version of viser; the scene can be looked at without them.";
    } else {
      setTimeout(begin, 100, since);
    }
  }

  // On a phone the toolbar would cover the scene.
  document.getElementById("gsc").open = window.innerWidth > 600;
  count();
  begin(performance.now());
})();
