// Filament (npm filament) and Babylon.js (npm babylonjs) in headless Chromium on exports of a calibration bake: every
// direction of the sky that they show is where it is, and of the brightness that it is.
//
// Usage: node viewers.mjs <folder of node_modules> <export for filament> <export for gltf> <probe> <chromium>
import { createServer } from 'node:http';
import { readFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { extname, join, normalize } from 'node:path';

const [, , tools, filament, gltf, probe, chromium] = process.argv;
const { chromium: browserType } = createRequire(join(tools, 'package.json'))('playwright-core');
const TEXEL = 2 / 64;
const EDGE = 96;

const roots = { modules: join(tools, 'node_modules'), filament, gltf };
const types = { '.html': 'text/html', '.js': 'text/javascript', '.wasm': 'application/wasm', '.png': 'image/png' };
const server = createServer((request, response) => {
  if (request.url === '/') {
    response.setHeader('content-type', 'text/html');
    return response.end(`<!doctype html><canvas id="canvas" width="${EDGE}" height="${EDGE}"></canvas>`);
  }
  const [root, ...rest] = normalize(decodeURIComponent(request.url.split('?')[0])).slice(1).split('/');
  try {
    response.setHeader('content-type', types[extname(request.url)] ?? 'application/octet-stream');
    response.end(readFileSync(join(roots[root], ...rest)));
  } catch {
    response.statusCode = 404;
    response.end();
  }
});
await new Promise((done) => server.listen(0, '127.0.0.1', done));
const url = `http://127.0.0.1:${server.address().port}/`;
const browser = await browserType.launch({
  executablePath: chromium,
  args: ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader'],
});

// The views, and what the pages share: reads the canvas in the task that drew it.
const VIEWS = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
const up = (forward) => (forward[1] === 0 ? [0, 1, 0] : [0, 0, 1]);
const pixels = () => {
  const copy = document.createElement('canvas');
  const canvas = document.getElementById('canvas');
  copy.width = canvas.width;
  copy.height = canvas.height;
  const context = copy.getContext('2d');
  context.drawImage(canvas, 0, 0);
  return [...context.getImageData(0, 0, copy.width, copy.height).data];
};

/// Views of the sky by Filament, linear: post-processing is off.
async function filamentViews(page) {
  await page.goto(url);
  await page.addScriptTag({ url: 'modules/gl-matrix/gl-matrix-min.js' });
  // Filament expects its types as globals.
  await page.evaluate(() => { Object.assign(window, glMatrix); });
  await page.addScriptTag({ url: 'modules/filament/filament.js' });
  return page.evaluate(async ([views, ups, probe, readPixels]) => {
    const read = new Function(`return (${readPixels})()`);
    const folder = `filament/${probe}/${probe}`;
    const assets = [`${folder}_ibl.ktx`, `${folder}_skybox.ktx`];
    const list = await (await fetch('filament/probes.json')).json();
    await new Promise((done) => Filament.init(assets, done));
    const engine = Filament.Engine.create(document.getElementById('canvas'));
    const scene = engine.createScene();
    const light = engine.createIblFromKtx1(assets[0]);
    light.setIntensity(list.intensityAtDefaultExposure);
    scene.setIndirectLight(light);
    scene.setSkybox(engine.createSkyFromKtx1(assets[1]));
    const view = engine.createView();
    const camera = engine.createCamera(Filament.EntityManager.get().create());
    const canvas = document.getElementById('canvas');
    view.setCamera(camera);
    view.setScene(scene);
    view.setViewport([0, 0, canvas.width, canvas.height]);
    view.setPostProcessingEnabled(false);
    camera.setProjectionFov(90, 1, 0.1, 10, Filament.Camera$Fov.VERTICAL);
    const renderer = engine.createRenderer();
    const swapChain = engine.createSwapChain();
    const frames = [];
    for (let i = 0; i < views.length; i++) {
      camera.lookAt([0, 0, 0], views[i], ups[i]);
      // Several: materials and textures become ready in the first.
      let frame;
      for (let turn = 0; turn < 4; turn++) {
        renderer.render(swapChain, view);
        engine.execute();
        frame = read();
        await new Promise(requestAnimationFrame);
      }
      frames.push(frame);
    }
    return frames;
  }, [VIEWS, VIEWS.map(up), probe, pixels.toString()]);
}

/// Views of the sky by Babylon.js, whose world is left-handed.
async function babylonViews(page) {
  await page.goto(url);
  await page.addScriptTag({ url: 'modules/babylonjs/babylon.js' });
  await page.addScriptTag({ url: 'modules/babylonjs-loaders/babylonjs.loaders.min.js' });
  return page.evaluate(async ([views, ups, readPixels]) => {
    const read = new Function(`return (${readPixels})()`);
    const engine = new BABYLON.Engine(document.getElementById('canvas'), false, { preserveDrawingBuffer: true });
    const scene = new BABYLON.Scene(engine);
    await BABYLON.SceneLoader.AppendAsync('gltf/', 'probes.gltf', scene);
    const camera = new BABYLON.FreeCamera('camera', BABYLON.Vector3.Zero(), scene);
    scene.activeCamera = camera;
    camera.fov = Math.PI / 2;
    camera.minZ = 0.1;
    scene.createDefaultSkybox(scene.environmentTexture, true, 10, 0);
    const frames = [];
    await scene.whenReadyAsync();
    for (let i = 0; i < views.length; i++) {
      camera.upVector = BABYLON.Vector3.FromArray(ups[i]);
      camera.setTarget(BABYLON.Vector3.FromArray(views[i]));
      scene.render();
      scene.render();
      frames.push(read());
    }
    const harmonics = scene.environmentTexture.sphericalPolynomial.preScaledHarmonics;
    const names = ['l00', 'l1_1', 'l10', 'l11', 'l2_2', 'l2_1', 'l20', 'l21', 'l22'];
    return { frames, harmonics: names.map((name) => harmonics[name].asArray()) };
  }, [VIEWS, VIEWS.map(up), pixels.toString()]);
}

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const length = (v) => Math.hypot(...v);

/// Largest angle and error of brightness over the pixels that are neither clipped nor touched by marks, where radiance is not
/// (d + 1) / 2 of the unit direction d to within a tenth. A wrong orientation leaves few of them.
function judge(name, frames, handedness, manifestFromViewer) {
  let worst = 0;
  let brightness = 0;
  let counted = 0;
  frames.forEach((frame, i) => {
    const forward = VIEWS[i];
    const upward = up(forward);
    const right = cross(forward, upward).map((value) => value * handedness);
    for (let y = 0; y < EDGE; y++) {
      for (let x = 0; x < EDGE; x++) {
        const [sx, sy] = [((x + 0.5) / EDGE) * 2 - 1, 1 - ((y + 0.5) / EDGE) * 2];
        const ray = forward.map((value, axis) => value + sx * right[axis] + sy * upward[axis]);
        const expected = manifestFromViewer(ray.map((value) => value / length(ray)));
        const colour = frame.slice(4 * (y * EDGE + x), 4 * (y * EDGE + x) + 3).map((byte) => byte / 255);
        if (Math.max(...colour) > 0.99) continue;
        const code = expected.map((value) => (value + 1) / 2);
        const factor = colour.reduce((sum, value, axis) => sum + value * code[axis], 0) / length(code) ** 2;
        if (Math.abs(factor - 1) > 0.1) continue;
        const found = colour.map((value) => 2 * value - 1);
        const cosine = found.reduce((sum, value, axis) => sum + value * expected[axis], 0) / length(found);
        worst = Math.max(worst, Math.acos(Math.min(1, cosine)));
        brightness = Math.max(brightness, ...colour.map((value, axis) => Math.abs(value - code[axis])));
        counted++;
      }
    }
  });
  const share = counted / (6 * EDGE * EDGE);
  console.log(`${name}: directions within ${(worst / TEXEL).toFixed(2)} texels, ` +
    `radiance within ${brightness.toFixed(3)}, ${(100 * share).toFixed(0)} % of the pixels`);
  return worst < TEXEL && share > 0.8 && brightness < 0.05;
}

/// Irradiance over pi as the shader of Babylon.js' PBR materials computes it, against Filament's, whose coefficients sh.txt holds.
function judgeIrradiance(harmonics) {
  const text = readFileSync(join(filament, probe, 'sh.txt'), 'utf8');
  const sh = text.trim().split('\n').map((line) => line.slice(1, line.indexOf(')')).split(',').map(Number));
  // Both shaders have this polynomial.
  const irradiance = (coefficients, [x, y, z]) => {
    const basis = [1, y, z, x, y * x, y * z, 3 * z * z - 1, z * x, x * x - y * y];
    return [0, 1, 2].map((channel) => basis.reduce((sum, value, i) => sum + value * coefficients[i][channel], 0));
  };
  let worst = 0;
  for (const [x, y, z] of VIEWS.concat([[0.6, 0.64, 0.48], [-0.48, 0.6, -0.64], [0.64, -0.48, -0.6]])) {
    const expected = irradiance(sh, [x, y, z]);
    const found = irradiance(harmonics, [-x, y, z]);
    worst = Math.max(worst, ...found.map((value, channel) => Math.abs(value / expected[channel] - 1)));
  }
  console.log(`Babylon.js: irradiance within ${(100 * worst).toFixed(2)} % of Filament's`);
  return worst < 0.001;
}

const page = await browser.newPage();
page.on('pageerror', (error) => console.error(String(error)));
const shown = await filamentViews(page);
const { frames, harmonics } = await babylonViews(page);
await browser.close();
server.close();
const verdicts = [
  judge('Filament', shown, 1, (d) => d),
  judge('Babylon.js', frames, -1, ([x, y, z]) => [-x, y, z]),
  judgeIrradiance(harmonics),
];
process.exit(verdicts.every(Boolean) ? 0 : 1);
