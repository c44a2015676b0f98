// Where splats are on the canvas, and which is seen at a place of it. A buffer of viser holds eight
// words of 32 bits for each: position, group, covariance in half precision, and colour with opacity.

const WORDS = 8, COVARIANCE = 4, COLOUR = 7, MIN_ALPHA = 1 / 255;
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const center = (buffer, i) => new Float32Array(buffer.buffer, buffer.byteOffset + 4 * WORDS * i, 3);
const opacity = (buffer, i) => (buffer[WORDS * i + COLOUR] >>> 24) / 255;

/** A number in half precision from its bits. */
function half(bits) {
  const exponent = (bits >> 10) & 31, fraction = (bits & 1023) / 1024;
  return (bits >> 15 ? -1 : 1) * (exponent ? 2 ** (exponent - 15) * (1 + fraction) : 2 ** -14 * fraction);
}

/** Places of all splats in pixels, x and y by turns; NaN behind the camera. `matrix` leads from units of the buffer. */
function placesOf(buffer, { camera, canvas }, matrix) {
  const places = new Float32Array(buffer.length / WORDS * 2);
  const m = camera.projectionMatrix.clone().multiply(camera.matrixWorldInverse).multiply(matrix).elements;
  const row = (k, p) => m[k] * p[0] + m[4 + k] * p[1] + m[8 + k] * p[2] + m[12 + k];
  for (let i = 0; i < places.length / 2; i++) {
    const p = center(buffer, i), w = row(3, p);
    places[2 * i] = w > 0 ? (0.5 + row(0, p) / w / 2) * canvas.clientWidth : NaN;
    places[2 * i + 1] = (0.5 - row(1, p) / w / 2) * canvas.clientHeight;
  }
  return places;
}

/** The splat of largest blending weight at a place in pixels, or null. */
function splatAt(buffer, { camera, canvas }, matrix, [x, y]) {
  const inverse = matrix.clone().invert(), vector = camera.position.clone();
  const end = vector.set((2 * x) / canvas.clientWidth - 1, 1 - (2 * y) / canvas.clientHeight, 0.5);
  const target = end.unproject(camera).applyMatrix4(inverse).clone();
  const origin = vector.setFromMatrixPosition(camera.matrixWorld).applyMatrix4(inverse).toArray();
  const forward = camera.getWorldDirection(vector.clone()).transformDirection(inverse).toArray();
  const ray = target.sub(vector).normalize();
  const right = ray.clone().set(1, 0, 0).cross(ray);
  if (right.length() < 0.1) right.set(0, 1, 0).cross(ray);
  const across = [right.normalize(), ray.clone().cross(right)].map((axis) => axis.toArray());
  const hits = [];
  for (let i = 0; i < buffer.length / WORDS; i++) {
    const offset = center(buffer, i).map((value, k) => value - origin[k]), depth = dot(offset, forward);
    const alpha = depth > 0 && opacity(buffer, i) ? alphaOf(buffer, i, offset, across) : 0;
    if (alpha > MIN_ALPHA) hits.push([depth, alpha, i]);
  }
  let largest = 0, found = null, transmittance = 1;
  for (const [, alpha, i] of hits.sort((a, b) => a[0] - b[0])) {
    if (alpha * transmittance > largest) [largest, found] = [alpha * transmittance, i];
    transmittance *= 1 - alpha;
  }
  return found;
}

/** Opacity of a splat where a ray passes its middle at `offset`; the axes u and v are across the ray. */
function alphaOf(buffer, i, offset, [u, v]) {
  const words = Array.from(buffer.subarray(WORDS * i + COVARIANCE, WORDS * i + COLOUR));
  const [xx, xy, xz, yy, yz, zz] = words.flatMap((word) => [half(word & 65535), half(word >>> 16)]);
  const times = (a) => [dot([xx, xy, xz], a), dot([xy, yy, yz], a), dot([xz, yz, zz], a)];
  const extra = 1e-6 * (xx + yy + zz) + 1e-30, p = dot(u, offset), q = dot(v, offset);
  const uu = dot(u, times(u)) + extra, vv = dot(v, times(v)) + extra, uv = dot(v, times(u));
  return opacity(buffer, i) * Math.exp((2 * uv * p * q - vv * p * p - uu * q * q) / (uu * vv - uv * uv) / 2);
}
