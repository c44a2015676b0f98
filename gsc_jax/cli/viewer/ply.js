"use strict";
// Some rows of a .ply that gsc-jax has written, with all of their properties.

const TYPES = { char: 1, uchar: 1, short: 2, ushort: 2, int: 4, uint: 4, float: 4, double: 8,
  int8: 1, uint8: 1, int16: 2, uint16: 2, int32: 4, uint32: 4, float32: 4, float64: 8 };

/** Where the vertices of a .ply are: bytes of the header and of a row, rows, and scores of rows. */
function layout(bytes) {
  const text = new TextDecoder("latin1").decode(bytes.subarray(0, 65536)); // a sign for each byte
  const header = /^ply\n[^]*?\nend_header\n/.exec(text)?.[0] ?? "";
  const [, type, count, properties] = /^element (\w+) (\d+)\n((?:(?:property|comment) .*\n)*)/m.exec(header) ?? [];
  if (!header.includes("\nformat binary_little_endian ") || type !== "vertex")
    throw new Error("Expected tamper.ply as gsc-jax wrote it, with the Gaussians as its first element.");
  let stride = 0, tamper = NaN;
  for (const line of properties.match(/^property .*$/gm) ?? []) {
    const [, type, name] = line.split(" ");
    if (name === "tamper") tamper = stride;
    stride += TYPES[type];
  }
  if (!(tamper < stride)) throw new Error("Expected numbers and a property tamper in each row of the file.");
  const view = new DataView(bytes.buffer, header.length);
  return { header, stride, count: Number(count), score: (row) => view.getFloat32(row * stride + tamper, true) };
}

/** Pieces of the file with the rows that are `kept`, and how many they are; an error if none is. */
function withRows(bytes, { header, stride, count }, kept) {
  const pieces = [], start = header.length;
  let rows = 0;
  for (let row = 0, from = 0; row <= count; row++) {
    if (row < count && kept(row)) continue;
    if (row > from) pieces.push(bytes.subarray(start + from * stride, start + row * stride));
    rows += row - from;
    from = row + 1;
  }
  if (!rows) throw new Error("No Gaussian was chosen; choose some.");
  const before = header.indexOf("element vertex ") + 15, after = header.indexOf("\n", before);
  pieces.unshift(bytes.subarray(0, before), String(rows), bytes.subarray(after, start));
  return { pieces: [...pieces, bytes.subarray(start + count * stride)], kept: rows };
}
