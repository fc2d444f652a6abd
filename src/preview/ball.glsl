// One probe's share of a ball, or of the view around, at a position. Shares are added up; alpha is coverage.

uniform samplerCube cube;
uniform vec3 sh[9];
uniform float weight;
uniform vec3 position, takenAt, proxyMin, proxyMax;
uniform mat3 worldFromCamera;
// 0 view, 1 ball that reflects, 2 diffuse ball.
uniform int shape;
uniform float lod;
// Half the width and height of the view's image plane at distance 1.
uniform vec2 extent;

in vec2 place;
out vec4 share;

void main() {
  float coverage = 1.0;
  vec3 direction = worldFromCamera * vec3(place * extent, -1.0);
  if (shape > 0) {
    float radius = length(place) / 0.96;
    coverage = clamp(0.5 + (1.0 - radius) / fwidth(radius), 0.0, 1.0);
    vec2 disc = place / 0.96 / max(radius, 1.0);
    vec3 normal = vec3(disc, sqrt(max(1.0 - dot(disc, disc), 0.0)));
    // The eye is far away along the camera's +Z.
    direction = worldFromCamera * (shape == 1 ? 2.0 * normal.z * normal - vec3(0.0, 0.0, 1.0) : normal);
  }
  vec3 corrected = probeDirection(position, normalize(direction), takenAt, proxyMin, proxyMax);
  vec3 radiance = shape == 2 ? probeIrradiance(sh, direction) : textureLod(cube, probeLookUp(corrected), lod).rgb;
  share = vec4(radiance, 1.0) * (weight * coverage);
}
