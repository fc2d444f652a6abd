// Which probes count at a position, and in which direction they are looked up: the same as splatprobe's
// src/place/interpolate.rs and the influence boxes of src/place/mod.rs. No dependencies.
//
// `manifest` is a parsed manifest.json. Positions and directions are arrays [x, y, z] in its frame: right-handed, +Y up,
// metres.

/**
 * The probes blended at a position: [{probe, weight}] by ascending index, their weights sum to 1. With a triangulation
 * there is always one; of influence boxes alone none where no box reaches.
 */
export function weights(manifest, position) {
  const levels = (manifest.placement?.levels ?? []).filter((level) => level.triangles.length > 0);
  return levels.length > 0 ? triangulated(levels, position) : boxed(manifest.probes, position);
}

/** Direction from where a probe was taken to where the ray from `position` leaves its proxy box; not normalised. */
export function parallaxCorrected(probe, position, direction) {
  const { min, max } = probe.proxy;
  const inside = position.map((p, axis) => Math.min(Math.max(p, min[axis]), max[axis]));
  const exits = direction.map((d, axis) => (d === 0 ? Infinity : ((d > 0 ? max : min)[axis] - inside[axis]) / d));
  const distance = Math.max(Math.min(...exits), 0);
  return inside.map((p, axis) => p + direction[axis] * distance - probe.position[axis]);
}

/**
 * Factors s of irradiance over pi by normal n:
 * s0 + s1 y + s2 z + s3 x + s4 xy + s5 yz + s6 (3 z^2 - 1) + s7 xz + s8 (x^2 - y^2), nine times [r, g, b].
 */
export function irradianceFactors(sh) {
  const raw = (sh.windowed ?? sh).coefficients;
  // A_l / pi times the constants of the real harmonics.
  const factors = [0.282095, 0.325735, 0.325735, 0.325735, 0.273137, 0.273137, 0.078848, 0.273137, 0.136569];
  return factors.map((factor, i) => raw[i].map((value) => value * factor));
}

/** The `count` shares with the greatest weights, which again sum to 1. */
export function greatest(shares, count) {
  const kept = [...shares].sort((a, b) => b.weight - a.weight).slice(0, count);
  const sum = kept.reduce((total, share) => total + share.weight, 0);
  return kept.map(({ probe, weight }) => ({ probe, weight: weight / sum }));
}

function boxed(probes, position) {
  const shares = probes.map(({ influence: { min, max, blend } }, probe) => {
    let weight = 1;
    for (let axis = 0; axis < 3; axis++) {
      const [above, below] = [max[axis] - position[axis], position[axis] - min[axis]];
      const ramp = (depth, over) => (depth < 0 ? 0 : depth < over ? depth / over : 1);
      weight *= ramp(above, blend[2 * axis]) * ramp(below, blend[2 * axis + 1]);
    }
    return { probe, weight };
  });
  const reaching = shares.filter((share) => share.weight > 0);
  return greatest(reaching, reaching.length).sort((a, b) => a.probe - b.probe);
}

function triangulated(levels, [x, y, z]) {
  const away = ({ height }) => Math.max(height.floor - y, y - height.ceiling, 0);
  const least = Math.min(...levels.map(away));
  const storey = levels.filter((level) => away(level) === least);
  const split = storey.filter((level) => level.height.y <= y).length;
  const [below, above] = [storey[split - 1], storey[split]];
  const up = below && above ? (y - below.height.y) / (above.height.y - below.height.y) : above ? 1 : 0;
  const sums = new Map();
  for (const [level, share] of [[below, 1 - up], [above, up]]) {
    if (!level) continue;
    const { triangle, corners } = locate(level, [x, z]);
    unblocked(level, triangle, corners).forEach((corner, i) => {
      for (const { probe, weight } of level.vertices[level.triangles[triangle][i]].blend) {
        sums.set(probe, (sums.get(probe) ?? 0) + weight * corner * share);
      }
    });
  }
  const shares = [...sums].map(([probe, weight]) => ({ probe, weight }));
  return shares.filter((share) => share.weight > 0).sort((a, b) => a.probe - b.probe);
}

/** The triangle that a point of the plan lies in and its corners' weights; outside of all, those of their nearest point. */
function locate(level, point) {
  let nearest = { distance: Infinity, triangle: 0, corners: [1, 0, 0] };
  for (let triangle = 0; triangle < level.triangles.length && nearest.distance > 0; triangle++) {
    const [a, b, c] = level.triangles[triangle].map((vertex) => level.vertices[vertex].position);
    const corners = nearestWeights(a, b, c, point);
    const distance = squaredDistance(a, b, c, corners, point);
    if (distance < nearest.distance) nearest = { distance, triangle, corners };
  }
  return nearest;
}

/** From the heaviest corner down, of equal ones from the first, a corner counts unless a blocked edge joins it to one that counts. */
function unblocked(level, triangle, corners) {
  const vertices = level.triangles[triangle];
  const isBlocked = (a, b) => {
    const [low, high] = [Math.min(vertices[a], vertices[b]), Math.max(vertices[a], vertices[b])];
    return level.blocked.some((edge) => edge[0] === low && edge[1] === high);
  };
  const kept = [0, 0, 0];
  for (const corner of [0, 1, 2].sort((a, b) => corners[b] - corners[a])) {
    if (kept.every((weight, other) => weight === 0 || !isBlocked(corner, other))) kept[corner] = corners[corner];
  }
  const sum = kept[0] + kept[1] + kept[2];
  return kept.map((weight) => weight / sum);
}

/** Barycentric weights of the point of a triangle that is nearest to `point`; one without area counts as its edges. */
function nearestWeights(a, b, c, point) {
  const cross = (o, p, q) => (p[0] - o[0]) * (q[1] - o[1]) - (p[1] - o[1]) * (q[0] - o[0]);
  const area = cross(a, b, c);
  if (area > 0) {
    const inner = [cross(point, b, c), cross(point, c, a), cross(point, a, b)];
    if (Math.min(...inner) >= 0) return inner.map((weight) => weight / area);
  }
  const along = (from, to) => {
    const edge = [to[0] - from[0], to[1] - from[1]];
    const squared = edge[0] ** 2 + edge[1] ** 2;
    const share = ((point[0] - from[0]) * edge[0] + (point[1] - from[1]) * edge[1]) / squared;
    return squared > 0 ? Math.min(Math.max(share, 0), 1) : 0;
  };
  const [ab, bc, ca] = [along(a, b), along(b, c), along(c, a)];
  const candidates = [[1 - ab, ab, 0], [0, 1 - bc, bc], [ca, 0, 1 - ca]];
  const distances = candidates.map((weights) => squaredDistance(a, b, c, weights, point));
  return candidates[distances.indexOf(Math.min(...distances))];
}

function squaredDistance(a, b, c, w, point) {
  const at = (axis) => a[axis] * w[0] + b[axis] * w[1] + c[axis] * w[2] - point[axis];
  return at(0) ** 2 + at(1) ** 2;
}
