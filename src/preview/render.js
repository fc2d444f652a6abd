// Balls and views from cube maps: each probe's share is added up in a float buffer, then shown at an exposure.

const VERTEX = `#version 300 es
out vec2 place;
void main() {
  place = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(place, 0.0, 1.0);
}`;

const SHOW = `#version 300 es
precision highp float;
uniform sampler2D shares;
uniform float exposure;
out vec4 shown;
void main() {
  vec4 sum = texelFetch(shares, ivec2(gl_FragCoord.xy), 0);
  vec3 linear = clamp(sum.rgb / max(sum.a, 1e-6) * exposure, 0.0, 1.0);
  vec3 encoded = mix(12.92 * linear, 1.055 * pow(linear, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, linear));
  shown = vec4(encoded, 1.0) * min(sum.a, 1.0);
}`;

class Renderer {
  constructor(data, glsl) {
    this.data = data;
    this.canvas = document.createElement('canvas');
    const gl = this.canvas.getContext('webgl2', { preserveDrawingBuffer: true, antialias: false });
    if (!gl) throw new Error('this browser has no WebGL 2; the plan and the table below need none');
    if (!gl.getExtension('EXT_color_buffer_float') && !gl.getExtension('EXT_color_buffer_half_float')) {
      throw new Error('this browser cannot add up light in half floats');
    }
    this.gl = gl;
    this.ball = program(gl, `#version 300 es\nprecision highp float;\n${glsl}`);
    this.show = program(gl, SHOW);
    this.shares = gl.createTexture();
    this.buffer = gl.createFramebuffer();
    this.textures = new Map();
    gl.blendFunc(gl.ONE, gl.ONE);
    gl.enable(gl.SCISSOR_TEST);
  }

  /** A probe's cube map with its mips, uploaded when it is first needed. */
  texture(probe) {
    if (this.textures.has(probe)) return this.textures.get(probe);
    const { gl, data } = this;
    const bytes = Uint8Array.from(atob(data.texels[probe]), (c) => c.charCodeAt(0));
    const words = new Uint32Array(bytes.buffer);
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_CUBE_MAP, texture);
    gl.texStorage2D(gl.TEXTURE_CUBE_MAP, data.mips.length, gl.RGB9_E5, data.faceSize, data.faceSize);
    let start = 0;
    data.mips.forEach(({ size }, mip) => {
      for (let slot = 0; slot < 6; slot++, start += size * size) {
        const texels = words.subarray(start, start + size * size);
        const target = gl.TEXTURE_CUBE_MAP_POSITIVE_X + slot;
        gl.texSubImage2D(target, mip, 0, 0, size, size, gl.RGB, gl.UNSIGNED_INT_5_9_9_9_REV, texels);
      }
    });
    gl.texParameteri(gl.TEXTURE_CUBE_MAP, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    this.textures.set(probe, texture);
    return texture;
  }

  /**
   * Draws pictures [{at: [left, top, width, height], shares, position, shape, roughness, worldFromCamera, extent}] on a 2D
   * canvas, which they cover. `shape` is 'view', 'mirror' or 'diffuse'.
   */
  draw(canvas, pictures, exposure) {
    const { gl } = this;
    const [width, height] = [canvas.width, canvas.height];
    [this.canvas.width, this.canvas.height] = [width, height];
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.shares);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, width, height, 0, gl.RGBA, gl.HALF_FLOAT, null);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.buffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.shares, 0);
    gl.scissor(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.useProgram(this.ball);
    for (const picture of pictures) this.add(picture, height);

    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.BLEND);
    gl.useProgram(this.show);
    gl.viewport(0, 0, width, height);
    gl.scissor(0, 0, width, height);
    gl.bindTexture(gl.TEXTURE_2D, this.shares);
    gl.uniform1f(gl.getUniformLocation(this.show, 'exposure'), exposure);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    const context = canvas.getContext('2d');
    context.clearRect(0, 0, width, height);
    context.drawImage(this.canvas, 0, 0);
  }

  add({ at: [left, top, width, height], shares, position, shape, roughness = 0, worldFromCamera, extent = [1, 1] }, all) {
    const { gl, ball, data } = this;
    gl.viewport(left, all - top - height, width, height);
    gl.scissor(left, all - top - height, width, height);
    const uniform = (name) => gl.getUniformLocation(ball, name);
    gl.uniform3fv(uniform('position'), position);
    gl.uniformMatrix3fv(uniform('worldFromCamera'), false, worldFromCamera.flat());
    gl.uniform1i(uniform('shape'), ['view', 'mirror', 'diffuse'].indexOf(shape));
    gl.uniform1f(uniform('lod'), roughness * (data.mips.length - 1));
    gl.uniform2fv(uniform('extent'), extent);
    for (const { probe, weight } of shares) {
      const record = data.manifest.probes[probe];
      gl.bindTexture(gl.TEXTURE_CUBE_MAP, this.texture(probe));
      gl.uniform1f(uniform('weight'), weight);
      gl.uniform3fv(uniform('sh'), irradianceFactors(record.sh).flat());
      gl.uniform3fv(uniform('takenAt'), record.position);
      gl.uniform3fv(uniform('proxyMin'), record.proxy.min);
      gl.uniform3fv(uniform('proxyMax'), record.proxy.max);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }
  }
}

function program(gl, fragment) {
  const program = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  return program;
}
