// Loads an export for a web engine: probes.json and the cube maps beside it. No dependencies.

import { greatest, irradianceFactors, weights } from './probes.js';

/** Probes that a material blends; further ones, whose weights are smaller, are left out. */
export const MAX_PROBES = 4;

const FORMAT = 'splatprobe web 1';
const R16G16B16A16_SFLOAT = 97;

/**
 * Loads probes.json: its content, and a cube map per probe, {size, mips: [[six Uint16Array of RGBA half floats]]}, slots in
 * the order +X -X +Y -Y +Z -Z.
 */
export async function load(url) {
  const base = new URL(url, document.baseURI);
  const manifest = await (await get(base)).json();
  if (manifest.format !== FORMAT) {
    throw new Error(`${base}: format '${manifest.format}'; this module reads '${FORMAT}': export again`);
  }
  const cubes = await Promise.all(manifest.probes.map(async ({ specular }) => {
    const address = new URL(specular, base);
    return cubeMap(address, await (await get(address)).arrayBuffer());
  }));
  return { manifest, cubes };
}

/**
 * What a material needs at a position of the manifest's frame: `probes`, MAX_PROBES of them by index, the last repeated;
 * their `weights`, 0 for the repeated; and `sh`, the blend of their irradiance factors as 27 numbers.
 */
export function selection(manifest, position) {
  const shares = greatest(weights(manifest, position), MAX_PROBES);
  const slots = Array.from({ length: MAX_PROBES }, (_, i) => shares[i] ?? { probe: shares[0]?.probe ?? 0, weight: 0 });
  const sh = new Array(27).fill(0);
  for (const { probe, weight } of shares) {
    irradianceFactors(manifest.probes[probe].sh).flat().forEach((value, i) => (sh[i] += weight * value));
  }
  return { probes: slots.map(({ probe }) => probe), weights: slots.map(({ weight }) => weight), sh };
}

async function get(address) {
  const response = await fetch(address);
  if (!response.ok) throw new Error(`${address}: ${response.status} ${response.statusText}`);
  return response;
}

/** A KTX 2.0 cube map of half floats without supercompression, as the exporter writes it. */
function cubeMap(address, buffer) {
  const view = new DataView(buffer);
  const word = (at) => view.getUint32(at, true);
  const isKtx2 = buffer.byteLength >= 80 && word(0) === 0x58544bab && word(4) === 0xbb303220 && word(8) === 0x0a1a0a0d;
  if (!isKtx2 || word(12) !== R16G16B16A16_SFLOAT || word(36) !== 6 || word(44) !== 0) {
    throw new Error(`${address}: not a plain KTX2 cube map of half floats: export again`);
  }
  const size = word(20);
  const mips = Array.from({ length: word(40) }, (_, mip) => {
    const start = Number(view.getBigUint64(80 + 24 * mip, true));
    const values = 4 * (size >> mip) ** 2;
    return Array.from({ length: 6 }, (_, slot) => new Uint16Array(buffer, start + 2 * slot * values, values));
  });
  return { size, mips };
}
