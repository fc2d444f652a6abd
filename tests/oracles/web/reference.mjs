// What a mirror ball shows, computed on the CPU from the bake's own specular.ktx2 and none of the exporters' files or shaders.
import fs from 'node:fs';
import path from 'node:path';

export const half = (bits) => {
  const [sign, exponent, mantissa] = [bits >> 15 ? -1 : 1, (bits >> 10) & 31, bits & 1023];
  return exponent ? sign * 2 ** (exponent - 15) * (1 + mantissa / 1024) : (sign * mantissa) / 2 ** 24;
};

// OpenGL 4.6, table 8.19: slot and the place in it, 0 to 1, by direction; and a direction through a place of a slot, also
// beyond its edges.
export function locate([x, y, z]) {
  const [ax, ay, az] = [x, y, z].map(Math.abs);
  let row;
  if (ax >= ay && ax >= az) row = x > 0 ? [0, -z, -y, ax] : [1, z, -y, ax];
  else if (ay >= az) row = y > 0 ? [2, x, z, ay] : [3, x, -z, ay];
  else row = z > 0 ? [4, x, -y, az] : [5, -x, -y, az];
  return [row[0], (row[1] / row[3] + 1) / 2, (row[2] / row[3] + 1) / 2];
}
export const through = [
  (s, t) => [1, -t, -s], (s, t) => [-1, -t, s], (s, t) => [s, 1, t], (s, t) => [s, -1, -t], (s, t) => [s, -t, 1], (s, t) => [-s, -t, -1],
];

/** Bilinear look-ups in mip 0 of a bake's cube map, by a direction of the manifest's frame. */
export async function cubeMap(file, { read, zstandard }) {
  const container = read(new Uint8Array(fs.readFileSync(file)));
  const size = container.pixelWidth;
  const [level] = container.levels;
  const data = zstandard.decode(level.levelData, level.uncompressedByteLength);
  const view = new DataView(data.buffer, data.byteOffset, data.length);
  const texel = (slot, x, y) => [0, 1, 2].map((k) => half(view.getUint16(8 * ((slot * size + y) * size + x) + 2 * k, true)));
  const tap = (slot, x, y) => {
    if (x >= 0 && y >= 0 && x < size && y < size) return texel(slot, x, y);
    // Beyond an edge lies the neighbour's nearest texel.
    const [other, s, t] = locate(through[slot]((2 * (x + 0.5)) / size - 1, (2 * (y + 0.5)) / size - 1));
    const index = (place) => Math.min(size - 1, Math.floor(place * size));
    return texel(other, index(s), index(t));
  };
  return (direction) => {
    const [slot, s, t] = locate(direction);
    const [x, y] = [s * size - 0.5, t * size - 0.5];
    const [left, top] = [Math.floor(x), Math.floor(y)];
    const [fx, fy] = [x - left, y - top];
    const taps = [tap(slot, left, top), tap(slot, left + 1, top), tap(slot, left, top + 1), tap(slot, left + 1, top + 1)];
    const shares = [(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy];
    return [0, 1, 2].map((k) => taps.reduce((sum, colour, i) => sum + colour[k] * shares[i], 0));
  };
}

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
/** Display encodings: the exact sRGB curve, and the power that stands for it in PlayCanvas. */
export const encodings = {
  srgb: (value) => (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055),
  power: (value) => value ** (1 / 2.2),
};

/**
 * RGBA bytes of a mirror ball of `radius` metres at `position`, seen from +Z without perspective, as wide as `fill` of
 * `size` pixels; alpha is 0 outside of 95 % of its radius, where an engine's triangles are too coarse for the last grazing
 * rays.
 */
export function mirrorBall({ manifest, lookUps, shares, position, radius, size, fill = 1, encoding = 'srgb' }) {
  const encode = (linear) => Math.round(255 * encodings[encoding](clamp(linear, 0, 1)));
  const pixels = new Uint8Array(4 * size * size);
  for (let row = 0; row < size; row++) {
    for (let column = 0; column < size; column++) {
      const [x, y] = [(2 * column + 1) / size - 1, 1 - (2 * row + 1) / size].map((place) => place / fill);
      if (x * x + y * y > 0.95 ** 2) continue;
      const n = [x, y, Math.sqrt(1 - x * x - y * y)];
      const direction = [2 * n[2] * n[0], 2 * n[2] * n[1], 2 * n[2] * n[2] - 1];
      const sum = [0, 0, 0];
      for (const { probe, weight } of shares) {
        const { position: takenAt, proxy: { min, max } } = manifest.probes[probe];
        const inside = position.map((p, k) => clamp(p + radius * n[k], min[k], max[k]));
        const exits = direction.map((d, k) => (d === 0 ? Infinity : ((d > 0 ? max[k] : min[k]) - inside[k]) / d));
        const distance = Math.min(...exits);
        const corrected = inside.map((p, k) => p + distance * direction[k] - takenAt[k]);
        lookUps[probe](corrected).forEach((value, k) => (sum[k] += weight * value));
      }
      pixels.set([...sum.map(encode), 255], 4 * (row * size + column));
    }
  }
  return pixels;
}
