// Reads a calibration bake's KTX2 files with ktx-parse and looks every direction up as a graphics API does.
import fs from 'node:fs';
import path from 'node:path';
import assert from 'node:assert';
import { createRequire } from 'node:module';
import { pathToFileURL } from 'node:url';

const [tools, folder] = process.argv.slice(2);
const require = createRequire(path.join(tools, 'package.json'));
const load = (name) => import(pathToFileURL(require.resolve(name)));
const { read } = await load('ktx-parse');
const { ZSTDDecoder } = await load('zstddec');
const zstandard = new ZSTDDecoder();
await zstandard.init();

const FORMATS = { 97: 'R16G16B16A16_SFLOAT', 123: 'E5B9G9R9_UFLOAT_PACK32' };

function half(bits) {
  const [sign, exponent, mantissa] = [bits >> 15 ? -1 : 1, (bits >> 10) & 31, bits & 1023];
  return exponent ? sign * 2 ** (exponent - 15) * (1 + mantissa / 1024) : (sign * mantissa) / 2 ** 24;
}

function texel(view, format, i) {
  if (format === 97) return [0, 1, 2].map((k) => half(view.getUint16(8 * i + 2 * k, true)));
  const word = view.getUint32(4 * i, true);
  return [0, 9, 18].map((shift) => ((word >>> shift) & 511) * 2 ** ((word >>> 27) - 24));
}

// OpenGL 4.6, table 8.19: slot, s, t, major axis.
function lookUp([x, y, z], size) {
  const [ax, ay, az] = [x, y, z].map(Math.abs);
  let row;
  if (ax >= ay && ax >= az) row = x > 0 ? [0, -z, -y, ax] : [1, z, -y, ax];
  else if (ay >= az) row = y > 0 ? [2, x, z, ay] : [3, x, -z, ay];
  else row = z > 0 ? [4, x, -y, az] : [5, -x, -y, az];
  const [slot, s, t, major] = row;
  const at = (c) => Math.min(size - 1, Math.floor(((c / major + 1) / 2) * size));
  return (slot * size + at(t)) * size + at(s);
}

for (const name of ['specular.ktx2', 'irradiance.ktx2']) {
  const file = read(new Uint8Array(fs.readFileSync(path.join(folder, name))));
  assert.equal(file.faceCount, 6);
  assert.ok(FORMATS[file.vkFormat], `format ${file.vkFormat}`);
  assert.equal(file.supercompressionScheme, 2);
  assert.equal(file.keyValue.KTXorientation, 'rd');
  assert.equal(file.dataFormatDescriptor[0].samples.length, file.vkFormat === 97 ? 4 : 6);
  const bytes = file.vkFormat === 97 ? 8 : 4;
  const levels = file.levels.map((level, i) => {
    const data = zstandard.decode(level.levelData, level.uncompressedByteLength);
    const size = file.pixelWidth >> i;
    assert.equal(data.length, 6 * size * size * bytes);
    assert.equal(data.length, level.uncompressedByteLength);
    return new DataView(data.buffer, data.byteOffset, data.length);
  });
  if (name !== 'specular.ktx2') continue;
  let worst = 0;
  for (let i = 0; i < 20000; i++) {
    const y = 1 - (2 * (i + 0.5)) / 20000;
    const r = Math.sqrt(1 - y * y);
    const d = [r * Math.cos(i * 2.399963), y, r * Math.sin(i * 2.399963)];
    let code = texel(levels[0], file.vkFormat, lookUp(d, file.pixelWidth));
    if (Math.max(...code) > 1.3) code = code.map((c) => c / 8);
    const found = code.map((c) => 2 * c - 1);
    const cosine = found.reduce((sum, c, k) => sum + c * d[k], 0) / Math.hypot(...found);
    worst = Math.max(worst, Math.acos(Math.min(1, cosine)));
  }
  assert.ok(worst < 2 / file.pixelWidth, `${worst} rad is more than a texel`);
  console.log(`${name}: ${FORMATS[file.vkFormat]}, ${levels.length} levels, worst direction ${worst.toFixed(4)} rad`);
}
