// Loads exports in the engines and the preview in headless Chromium and compares mirror balls with the CPU's.
//
//   node run.mjs TOOLS BAKE EXPORTS PREVIEW.html PICTURES
import fs from 'node:fs';
import http from 'node:http';
import path from 'node:path';
import assert from 'node:assert';
import { createRequire } from 'node:module';
import { fileURLToPath, pathToFileURL } from 'node:url';
import { cubeMap, mirrorBall } from './reference.mjs';

const [tools, bake, exports, preview, pictures] = process.argv.slice(2).map((argument) => path.resolve(argument));
const here = path.dirname(fileURLToPath(import.meta.url));
const require = createRequire(path.join(tools, 'package.json'));
const { chromium } = require('playwright-core');
const { PNG } = require('pngjs');
const { read } = await import(pathToFileURL(require.resolve('ktx-parse')));
const { ZSTDDecoder } = await import(pathToFileURL(require.resolve('zstddec')));
const { weights } = await import(pathToFileURL(path.join(exports, 'three/probes.js')));
const zstandard = new ZSTDDecoder();
await zstandard.init();

const LIMIT = 2;
const SIZE = 512;
const [RADIUS, DISTANCE] = [0.05, 50];
const manifest = JSON.parse(fs.readFileSync(path.join(bake, 'manifest.json')));
const lookUps = [];
for (const { files } of manifest.probes) {
  const { path: name } = files.find(({ role, format }) => role === 'specular' && format === 'ktx2');
  lookUps.push(await cubeMap(path.join(bake, name), { read, zstandard }));
}

const IMPORTS = {
  three: '/tools/three/build/three.module.js',
  '@babylonjs/core': '/tools/babylon-core.mjs',
  playcanvas: '/tools/playcanvas/build/playcanvas.mjs',
};
const page = (engine) => `<!DOCTYPE html><style>body { margin: 0 }</style><canvas width="${SIZE}" height="${SIZE}" style="width:${SIZE}px;height:${SIZE}px"></canvas>
<script type="importmap">${JSON.stringify({ imports: IMPORTS })}</script>
<script type="module">import { render } from '/here/${engine}.mjs'; window.render = render;</script>`;
const TYPES = { '.js': 'text/javascript', '.mjs': 'text/javascript', '.json': 'application/json' };
let engine = '';
const server = http.createServer((request, response) => {
  const [, root, ...rest] = decodeURIComponent(new URL(request.url, 'http://localhost').pathname).split('/');
  const folder = { here, tools: path.join(tools, 'node_modules'), export: path.join(exports, engine) }[root];
  const file = folder && path.join(folder, ...rest);
  if (!folder) return response.setHeader('content-type', 'text/html').end(page(engine));
  if (!fs.existsSync(file)) return response.writeHead(404).end();
  response.setHeader('content-type', TYPES[path.extname(file)] ?? 'application/octet-stream').end(fs.readFileSync(file));
});
await new Promise((resolve) => server.listen(0, '127.0.0.1', resolve));
const address = `http://127.0.0.1:${server.address().port}/`;

const executablePath = process.env.CHROMIUM ?? '/usr/bin/chromium';
const args = [
  '--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist',
  // Software takes its time.
  '--disable-gpu-watchdog',
];

function save(name, size, pixels) {
  const png = new PNG({ width: size, height: size });
  png.data.set(pixels);
  fs.writeFileSync(path.join(pictures, `${name}.png`), PNG.sync.write(png));
}

/** Root of the mean squared difference over all channels where the reference is opaque, in 255ths. */
function rms(found, expected) {
  let [sum, count] = [0, 0];
  for (let i = 0; i < expected.length; i += 4) {
    if (expected[i + 3] === 0) continue;
    for (let k = 0; k < 3; k++) sum += (found[i + k] - expected[i + k]) ** 2;
    count += 3;
  }
  return Math.sqrt(sum / count);
}

/** The pixels of a part of a canvas. */
const pixelsOf = (tab, selector, left, top, size) => tab.locator(selector).first().evaluate((canvas, [left, top, size]) => {
  const copy = new OffscreenCanvas(size, size).getContext('2d');
  copy.drawImage(canvas, -left, -top);
  return Array.from(copy.getImageData(0, 0, size, size).data);
}, [left, top, size]);

let worst = 0;
function judge(name, size, found, expected) {
  save(name, size, found);
  save(`${name}-expected`, size, expected);
  const error = rms(found, expected);
  worst = Math.max(worst, error);
  console.log(`${name}: ${error.toFixed(3)} / 255`);
}

/** A page in a browser of its own. */
async function open(options = {}) {
  const browser = await chromium.launch({ executablePath, args });
  const tab = await (await browser.newContext({ viewport: { width: 1400, height: 1000 }, ...options })).newPage();
  tab.setDefaultTimeout(120_000);
  tab.on('pageerror', (error) => assert.fail(error));
  tab.on('console', (message) => {
    if (['error', 'warning'].includes(message.type())) console.log(`  ${message.text()}`);
  });
  return tab;
}

// At a probe, and where two of them or more are blended.
const [a, b] = manifest.probes.map((probe) => probe.position);
const places = { at: a, between: a.map((value, axis) => value + 0.4 * ((b ?? a)[axis] - value)) };
for (engine of (process.env.ENGINES ?? 'three babylon playcanvas').split(' ')) {
  for (const [place, position] of Object.entries(places)) {
    const tab = await open();
    await tab.goto(address);
    await tab.waitForFunction(() => window.render);
    const settings = { position, radius: RADIUS, distance: DISTANCE };
    await tab.evaluate((settings) => window.render(document.querySelector('canvas'), settings), settings);
    const found = await pixelsOf(tab, 'canvas', 0, 0, SIZE);
    const encoding = engine === 'playcanvas' ? 'power' : 'srgb';
    const expected = mirrorBall({ manifest, lookUps, shares: weights(manifest, position), position, radius: RADIUS, size: SIZE, encoding });
    judge(`${engine}-${place}`, SIZE, found, expected);
    await tab.context().browser().close();
  }
}

// The preview: opened from disk, offline; its first card's mirror ball is 160 pixels wide below the unfolded cube.
const requests = [];
const tab = await open({ offline: true });
tab.on('request', (request) => requests.push(request.url()));
await tab.goto(pathToFileURL(preview).href);
await tab.waitForTimeout(2000);
assert.deepEqual(requests, [pathToFileURL(preview).href], 'the page asks for something');
await tab.screenshot({ path: path.join(pictures, 'preview-page.png'), fullPage: true });
const found = await pixelsOf(tab, '.card canvas', 0, 372, 160);
const expected = mirrorBall({ manifest, lookUps, shares: [{ probe: 0, weight: 1 }], position: a, radius: 0, size: 160, fill: 0.96 });
judge('preview', 160, found, expected);

await tab.context().browser().close();
server.close();
assert.ok(worst <= LIMIT, `${worst} / 255 is more than ${LIMIT}`);
