// The page: a point in the plan, what is reflected there, and every probe by itself.

const data = JSON.parse(document.getElementById('data').textContent);
const { manifest } = data;
const { probes } = manifest;
const levels = manifest.placement?.levels ?? [];
const id = (name) => document.getElementById(name);

// Everything that the user can change. The camera turns about +Y (yaw) and then about its own right (pitch), in radians.
const state = { chosen: 0, position: [...probes[0].position], level: 0, yaw: 0.6, pitch: 0 };

const ABSENT = '–';
const number = (value, digits = 2) => (value == null ? ABSENT : value.toFixed(digits));
const percent = (value) => (value == null ? ABSENT : `${(100 * value).toFixed(1)} %`);
const metres = (position) => position.map((value) => value.toFixed(2)).join(', ');

function element(parent, name, attributes = {}, text = '') {
  const made = document.createElementNS(parent.namespaceURI, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.textContent = text;
  return parent.appendChild(made);
}

// --- Pictures ---

let renderer;
try {
  renderer = new Renderer(data, id('probes-glsl').textContent + id('ball-glsl').textContent);
} catch (error) {
  id('fault').hidden = false;
  id('fault').textContent = `No balls: ${error.message}.`;
}

const exposure = () => 2 ** Number(id('exposure').value);
const roughness = () => Number(id('roughness').value);

function camera(yaw, pitch) {
  const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  return [[cy, 0, -sy], [sy * sp, cp, cy * sp], [sy * cp, -sp, cy * cp]];
}

/** A chrome, a rough and a diffuse ball in a row. */
function row(left, top, size, shares, position, worldFromCamera) {
  const shapes = [['mirror', 0], ['mirror', roughness()], ['diffuse', 0]];
  return shapes.map(([shape, roughness], i) => {
    return { at: [left + i * size, top, size, size], shares, position, shape, roughness, worldFromCamera };
  });
}

function drawPoint() {
  const shares = weights(manifest, state.position);
  const names = shares.map(({ probe, weight }) => `${probes[probe].id} ${percent(weight)}`).join(', ');
  const seen = names || 'no influence box reaches this point';
  id('point-caption').textContent =
    `At ${metres(state.position)} m: ${seen}. Above: what a mirror there shows (drag to look around); below: chrome, roughness ` +
    `${roughness().toFixed(2)} and diffuse balls, small, seen from the same side.`;
  for (const mark of document.querySelectorAll('.probe')) {
    mark.classList.toggle('counts', shares.some(({ probe }) => probe === Number(mark.dataset.probe)));
  }
  if (!renderer) return;
  const { position } = state;
  const worldFromCamera = camera(state.yaw, state.pitch);
  const { width, height } = id('view');
  const extent = [width / height, 1];
  const view = { at: [0, 0, width, height], shares, position, shape: 'view', worldFromCamera, extent };
  renderer.draw(id('view'), [view], exposure());
  renderer.draw(id('balls'), row(0, 0, id('balls').height, shares, position, worldFromCamera), exposure());
}

// Columns and rows of the faces in an unfolded cube; every camera looks along its -Z.
const FACES = [
  { cell: [2, 1], axes: [[0, 0, 1], [0, 1, 0], [-1, 0, 0]] },
  { cell: [0, 1], axes: [[0, 0, -1], [0, 1, 0], [1, 0, 0]] },
  { cell: [1, 0], axes: [[1, 0, 0], [0, 0, 1], [0, -1, 0]] },
  { cell: [1, 2], axes: [[1, 0, 0], [0, 0, -1], [0, 1, 0]] },
  { cell: [3, 1], axes: [[-1, 0, 0], [0, 1, 0], [0, 0, -1]] },
  { cell: [1, 1], axes: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] },
];

/** The probe's own cube, unfolded, and its balls where it was taken. */
function drawCard(canvas) {
  if (!renderer) return;
  const probe = Number(canvas.dataset.probe);
  const [shares, { position }] = [[{ probe, weight: 1 }], probes[probe]];
  const size = canvas.width / 4;
  const faces = FACES.map(({ cell: [column, line], axes }) => {
    return { at: [column * size, line * size, size, size], shares, position, shape: 'view', worldFromCamera: axes };
  });
  const balls = row(0, 3 * size + 12, canvas.width / 3, shares, position, camera(0, 0));
  renderer.draw(canvas, [...faces, ...balls], exposure());
}

// Cards out of sight are drawn when they come into it.
const visible = new Set();
const watcher = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    if (isIntersecting) visible.add(target);
    else visible.delete(target);
    if (isIntersecting) drawCard(target);
  }
}, { rootMargin: '200px' });

let pending = false;
function redraw() {
  if (pending) return;
  pending = true;
  requestAnimationFrame(() => {
    pending = false;
    drawPoint();
    visible.forEach(drawCard);
  });
}

// --- Plan ---

const worst = Math.max(...probes.map((probe) => probe.estimatedError ?? 0));

/** Green where the error is small, red where it is as large as anywhere. */
function errorColour(error) {
  if (error == null || worst === 0) return '#7a8294';
  return `hsl(${(140 * (1 - error / worst)).toFixed(0)} 55% 45%)`;
}

function planBounds() {
  const corners = probes.flatMap(({ influence, position }) => [influence.min, influence.max, position]);
  const [xs, zs] = [0, 2].map((axis) => corners.map((corner) => corner[axis]));
  const low = [Math.min(...xs), Math.min(...zs)];
  return { low, size: [Math.max(...xs) - low[0], Math.max(...zs) - low[1]] };
}

function drawPlan() {
  const plan = id('plan');
  plan.replaceChildren();
  const { low, size } = planBounds();
  const margin = 0.04 * Math.max(...size);
  const box = [low[0] - margin, low[1] - margin, size[0] + 2 * margin, size[1] + 3 * margin];
  plan.setAttribute('viewBox', box.join(' '));
  const dot = 0.012 * Math.max(...size);
  const level = levels[state.level];
  const line = (name, [a, b]) => {
    const [[x1, y1], [x2, y2]] = [level.vertices[a].position, level.vertices[b].position];
    element(plan, 'line', { class: name, x1, y1, x2, y2 });
  };
  for (const triangle of level?.triangles ?? []) {
    const corners = triangle.map((vertex) => level.vertices[vertex]);
    const errors = corners.flatMap(({ blend }) => blend.map(({ probe }) => probes[probe].estimatedError ?? 0));
    const mean = errors.reduce((sum, error) => sum + error, 0) / errors.length;
    const points = corners.map(({ position }) => position.join(',')).join(' ');
    element(plan, 'polygon', { class: 'triangle', points, fill: errorColour(mean), 'fill-opacity': 0.45 });
  }
  level?.walls.forEach((edge) => line('wall', edge));
  level?.blocked.forEach((edge) => line('blocked', edge));
  const outline = (name, { min, max }) => {
    element(plan, 'rect', { class: name, x: min[0], y: min[2], width: max[0] - min[0], height: max[2] - min[2] });
  };
  if (!level) probes.forEach(({ influence }) => outline('box', influence));
  outline('influence', probes[state.chosen].influence);
  outline('proxy', probes[state.chosen].proxy);
  probes.forEach((probe, index) => {
    const at = { cx: probe.position[0], cy: probe.position[2], r: dot };
    const mark = element(plan, 'circle', { class: 'probe', fill: errorColour(probe.estimatedError), 'data-probe': index, ...at });
    element(mark, 'title', {}, `${probe.id}, error ${percent(probe.estimatedError)}`);
  });
  element(plan, 'circle', { class: 'point', id: 'point', r: 1.6 * dot, cx: state.position[0], cy: state.position[2] });
  // The longest round length that fits a quarter of the plan.
  const scale = 10 ** Math.floor(Math.log10(size[0] / 4 || 1));
  const [x1, y1] = [low[0], low[1] + size[1] + margin];
  element(plan, 'line', { class: 'scale', x1, y1, x2: x1 + scale, y2: y1 });
  id('plan-caption').textContent =
    `From above: +X right, +Z down; the line is ${scale} m. Click for a point or a probe. ` +
    (level
      ? `Triangles are blended by barycentric weight; green to red: estimated error up to ${percent(worst)}; white: walls; red dashes: no sight. `
      : 'Probes are blended by their influence boxes. ') +
    `Of ${probes[state.chosen].id} the influence box is blue, the proxy box pink.`;
}

// --- Choice ---

function choose(probe) {
  state.chosen = probe;
  moveTo(probes[probe].position);
  document.querySelectorAll('.card').forEach((card, index) => card.classList.toggle('chosen', index === probe));
}

function moveTo(position) {
  state.position = [...position];
  id('height').value = position[1];
  const away = ({ height }) => Math.abs(height.y - position[1]);
  if (levels.length > 0) state.level = levels.reduce((best, level, i) => (away(level) < away(levels[best]) ? i : best), 0);
  id('level').value = state.level;
  drawPlan();
  showValues();
}

function showValues() {
  id('exposure-value').textContent = `${Number(id('exposure').value).toFixed(1)} EV`;
  id('roughness-value').textContent = roughness().toFixed(2);
  id('height-value').textContent = `${state.position[1].toFixed(2)} m`;
  redraw();
}

id('plan').addEventListener('click', (event) => {
  const probe = event.target.dataset.probe;
  if (probe !== undefined) return choose(Number(probe));
  const plan = id('plan');
  const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(plan.getScreenCTM().inverse());
  moveTo([x, state.position[1], y]);
});
id('view').addEventListener('pointermove', (event) => {
  if (event.buttons !== 1) return;
  const perPixel = 2 / id('view').clientHeight;
  state.yaw += event.movementX * perPixel;
  state.pitch = Math.min(Math.max(state.pitch + event.movementY * perPixel, -1.5), 1.5);
  redraw();
});
id('exposure').addEventListener('input', showValues);
id('roughness').addEventListener('input', showValues);
id('height').addEventListener('input', () => moveTo([state.position[0], Number(id('height').value), state.position[2]]));
id('level').addEventListener('change', () => {
  moveTo([state.position[0], levels[Number(id('level').value)].height.y, state.position[2]]);
});

// --- Text ---

function rows(table, header, lines) {
  const head = element(element(table, 'thead'), 'tr');
  header.forEach((text) => element(head, 'th', {}, text));
  const body = element(table, 'tbody');
  for (const cells of lines) {
    const line = element(body, 'tr');
    cells.forEach((text) => element(line, 'td', {}, text));
  }
}

function fill() {
  const heldOut = manifest.placement?.heldOut;
  id('summary').textContent = `${probes.length} probes, ${manifest.generator}`;
  const heights = probes.flatMap(({ influence }) => [influence.min[1], influence.max[1]]);
  [id('height').min, id('height').max] = [Math.min(...heights), Math.max(...heights)];
  id('level-label').hidden = levels.length < 2;
  levels.forEach(({ height }, i) => element(id('level'), 'option', { value: i }, `y = ${height.y.toFixed(2)} m`));
  probes.forEach((probe, index) => {
    const card = element(id('cards'), 'button', { class: 'card', type: 'button' });
    card.addEventListener('click', () => choose(index));
    const canvas = element(card, 'canvas', { width: 480, height: 532, 'data-probe': index });
    const error = probe.estimatedError == null ? '' : `, error ${percent(probe.estimatedError)}`;
    element(card, 'strong', {}, probe.id);
    element(card, 'span', {}, ` at ${metres(probe.position)} m${error}`);
    watcher.observe(canvas);
  });
  const header = ['Probe', 'Position (m)', 'Coverage', 'Nearest (m)', 'Mean distance (m)', 'Farthest (m)', 'Mean radiance', 'Brightest', 'Rays', 'Noise', 'Estimated error'];
  rows(id('statistics'), header, probes.map((probe, i) => {
    const { meanCoverage, distance, rays, surfaceNoise } = probe.statistics;
    const noise = surfaceNoise == null ? ABSENT : percent(surfaceNoise.standardError);
    return [probe.id, metres(probe.position), percent(meanCoverage), number(distance?.min), number(distance?.mean), number(distance?.max),
      number(data.mean[i], 3), number(data.brightest[i]), rays.toLocaleString('en'), noise, percent(probe.estimatedError)];
  }));
  const { colour, settings } = manifest;
  const lines = manifest.inputs.map(({ path, bytes }) => ['Input', `${path}, ${bytes.toLocaleString('en')} bytes`]);
  lines.push(['Faces', `${settings.faceSize} px, baked; ${colour.exposure} EV of exposure; tone mapper matched: ${colour.matchTonemapper}`]);
  if (heldOut) {
    const { adaptive, grid, positions, gridCounts } = heldOut;
    lines.push(['Error', `at ${positions} other positions: mean ${percent(adaptive.mean)}, 95 % below ${percent(adaptive.p95)}; ` +
      `a grid of ${gridCounts.join(' x ')}: ${percent(grid.mean)}, ${percent(grid.p95)}`]);
  }
  rows(id('bake'), ['Bake', ''], lines);
  const smaller = data.faceSize < data.bakedFaceSize ? `reduced from ${data.bakedFaceSize} to ${data.faceSize} px, so that ${probes.length} probes fit the page` : `at their ${data.faceSize} px`;
  const mips = data.mips.map(({ size, roughness }) => `${size} px: ${roughness.toFixed(2)}`).join(', ');
  id('notes').textContent =
    `Cube maps are held ${smaller}, nine bits per channel with a shared exponent. Rough reflection: GGX, prefiltered at roughnesses by mip (${mips}) and linear between. ` +
    'Diffuse: irradiance from the manifest\'s spherical harmonics, by normal. Every ball counts as small: all of it is blended and corrected as at its centre. ' +
    'Positions are in the manifest\'s frame, +Y up.';
}

fill();
choose(0);
