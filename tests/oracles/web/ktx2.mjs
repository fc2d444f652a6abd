// Reads all KTX2 files of the exports with ktx-parse.
import fs from 'node:fs';
import path from 'node:path';
import assert from 'node:assert';
import { createRequire } from 'node:module';
import { pathToFileURL } from 'node:url';

const [tools, exports] = process.argv.slice(2).map((argument) => path.resolve(argument));
const require = createRequire(path.join(tools, 'package.json'));
const { read } = await import(pathToFileURL(require.resolve('ktx-parse')));
const { ZSTDDecoder } = await import(pathToFileURL(require.resolve('zstddec')));
const zstandard = new ZSTDDecoder();
await zstandard.init();

const files = fs.readdirSync(exports, { recursive: true }).filter((name) => name.endsWith('.ktx2'));
assert.ok(files.length > 0);
for (const name of files) {
  const file = read(new Uint8Array(fs.readFileSync(path.join(exports, name))));
  assert.equal(file.faceCount, 6, name);
  assert.equal(file.vkFormat, 97, name);
  file.levels.forEach((level, mip) => {
    const size = file.pixelWidth >> mip;
    const isPlain = file.supercompressionScheme === 0;
    const data = isPlain ? level.levelData : zstandard.decode(level.levelData, level.uncompressedByteLength);
    assert.equal(data.length, 48 * size * size, `${name}: mip ${mip}`);
  });
}
console.log(`ktx-parse read ${files.length} files`);
