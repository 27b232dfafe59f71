// WebGL 2: meshes of quantised points, lines, a picture behind them; and the matrices they need (column-major, as GL's).

const HEAD = `#version 300 es
precision highp float;`;
const MESH_VERTEX = `${HEAD}
layout(location=0) in vec3 place; layout(location=1) in vec3 normal; layout(location=2) in float share; layout(location=3) in vec2 uv;
uniform mat4 view, projection; uniform vec3 low, size; out vec3 n; out float s; out vec2 at;
void main() { n = mat3(view) * normal; s = share; at = uv; gl_Position = projection * view * vec4(low + size * place, 1.0); }`;
const MESH_FRAGMENT = `${HEAD}
in vec3 n; in float s; in vec2 at; uniform vec3 colour; uniform float scaled, textured, alpha; uniform sampler2D picture; out vec4 pixel;
vec3 heat(float t) {
  vec3 c[5] = vec3[5](vec3(44,75,130), vec3(120,170,190), vec3(240,225,150), vec3(225,120,60), vec3(140,20,40));
  float at = clamp(t, 0.0, 1.0) * 4.0; int i = min(int(at), 3); return mix(c[i], c[i+1], at - float(i)) / 255.0; }
void main() {
  vec3 m = normalize(n) * (gl_FrontFacing ? 1.0 : -1.0);
  float light = 0.35 + 0.65 * max(dot(m, normalize(vec3(0.3, 0.5, 1.0))), 0.0);
  pixel = vec4(mix(mix(colour, heat(s), scaled), texture(picture, at).rgb, textured) * light * (gl_FrontFacing ? 1.0 : 0.75), alpha); }`;
const LINE_VERTEX = `${HEAD}
layout(location=0) in vec3 place; uniform mat4 view, projection; void main() { gl_Position = projection * view * vec4(place, 1.0); }`;
const LINE_FRAGMENT = `${HEAD}
uniform vec3 colour; out vec4 pixel; void main() { pixel = vec4(colour, 1.0); }`;
const PICTURE_VERTEX = `${HEAD}
out vec2 at; void main() { vec2 p = vec2(gl_VertexID & 1, gl_VertexID >> 1); at = vec2(p.x, 1.0 - p.y); gl_Position = vec4(2.0 * p - 1.0, 0.999, 1.0); }`;
const PICTURE_FRAGMENT = `${HEAD}
in vec2 at; uniform sampler2D picture; out vec4 pixel; void main() { pixel = texture(picture, at); }`;

export function programs(gl) {
  const make = (vertex, fragment) => {
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    return {program, at: name => gl.getUniformLocation(program, name)};
  };
  return {mesh: make(MESH_VERTEX, MESH_FRAGMENT), line: make(LINE_VERTEX, LINE_FRAGMENT), picture: make(PICTURE_VERTEX, PICTURE_FRAGMENT)};
}

// A surface whose points come as 24 bytes of corner and step, then uint16 (n,3). `split`: its vertices for each of their UVs,
// as the server sends them, for a surface with a texture.
export class Surface {
  constructor(gl, faces, split = null) {
    this.gl = gl;
    this.array = gl.createVertexArray();
    this.buffers = [0, 1, 2, 3, 4].map(() => gl.createBuffer());
    gl.bindVertexArray(this.array);
    const attribute = (i, size, kind, stride) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[i]);
      gl.enableVertexAttribArray(i);
      gl.vertexAttribPointer(i, size, kind, true, stride, 0);
    };
    attribute(0, 3, gl.UNSIGNED_SHORT, 6);
    attribute(1, 3, gl.BYTE, 4);
    attribute(2, 1, gl.UNSIGNED_BYTE, 1);
    if (split) {
      const count = new Uint32Array(split, 0, 1)[0];
      this.vertex = new Uint32Array(split, 4, count);
      attribute(3, 2, gl.UNSIGNED_SHORT, 4);
      this.put(3, new Uint16Array(split, 4 + 4 * count, 2 * count));
      this.setFaces(faces, new Uint32Array(split, 4 + 8 * count));
      this.texture = new Picture(gl);
    } else this.setFaces(faces);
  }
  setFaces(faces, drawn = faces) {
    this.faces = faces;
    this.count = drawn.length;
    this.gl.bindVertexArray(this.array);
    this.gl.bindBuffer(this.gl.ELEMENT_ARRAY_BUFFER, this.buffers[4]);
    this.gl.bufferData(this.gl.ELEMENT_ARRAY_BUFFER, drawn, this.gl.DYNAMIC_DRAW);
  }
  setPoints(bytes, offset = 0, count = (bytes.byteLength - offset - 24) / 6) {
    const head = new Float32Array(bytes.slice(offset, offset + 24));
    const points = new Uint16Array(bytes, offset + 24, 3 * count);
    this.low = [...head.slice(0, 3)];
    this.size = [...head.slice(3)].map(step => 65535 * step);
    this.put(0, this.each(points, 3));
    this.put(1, this.each(normals(points, head, this.faces), 4));
    if (this.shares?.length !== count) this.setShares(new Uint8Array(count));
  }
  setShares(shares) { this.shares = shares; this.put(2, this.each(shares, 1)); }
  // Rows of `width` numbers, one a vertex, as one a split vertex.
  each(values, width) {
    if (!this.vertex) return values;
    const out = new values.constructor(width * this.vertex.length);
    for (let i = 0, o = 0; i < this.vertex.length; i++)
      for (let k = 0, at = width * this.vertex[i]; k < width; k++) out[o++] = values[at + k];
    return out;
  }
  put(i, data) {
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, this.buffers[i]);
    this.gl.bufferData(this.gl.ARRAY_BUFFER, data, this.gl.DYNAMIC_DRAW);
  }
  draw(programs, view, projection, colour, scaled, textured, alpha) {
    const gl = this.gl, {program, at} = programs.mesh;
    if (!this.low) return;
    gl.useProgram(program);
    gl.uniformMatrix4fv(at('view'), false, view);
    gl.uniformMatrix4fv(at('projection'), false, projection);
    gl.uniform3fv(at('low'), this.low);
    gl.uniform3fv(at('size'), this.size);
    gl.uniform3fv(at('colour'), colour);
    gl.uniform1f(at('scaled'), scaled ? 1 : 0);
    gl.uniform1f(at('textured'), textured && this.texture ? 1 : 0);
    gl.uniform1f(at('alpha'), alpha);
    gl.bindTexture(gl.TEXTURE_2D, this.texture?.texture ?? null);
    gl.bindVertexArray(this.array);
    gl.drawElements(gl.TRIANGLES, this.count, gl.UNSIGNED_INT, 0);
  }
}

// Normals by the faces' areas, as four signed bytes a vertex.
function normals(q, [, , , sx, sy, sz], faces) {
  const sum = new Float32Array(q.length), out = new Int8Array(q.length / 3 * 4);
  for (let f = 0; f < faces.length; f += 3) {
    const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
    const ux = (q[b] - q[a]) * sx, uy = (q[b + 1] - q[a + 1]) * sy, uz = (q[b + 2] - q[a + 2]) * sz;
    const vx = (q[c] - q[a]) * sx, vy = (q[c + 1] - q[a + 1]) * sy, vz = (q[c + 2] - q[a + 2]) * sz;
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
    sum[a] += x; sum[a + 1] += y; sum[a + 2] += z;
    sum[b] += x; sum[b + 1] += y; sum[b + 2] += z;
    sum[c] += x; sum[c + 1] += y; sum[c + 2] += z;
  }
  for (let i = 0, o = 0; i < q.length; i += 3, o += 4) {
    const scale = 127 / (Math.sqrt(sum[i] ** 2 + sum[i + 1] ** 2 + sum[i + 2] ** 2) || 1);
    out[o] = sum[i] * scale; out[o + 1] = sum[i + 1] * scale; out[o + 2] = sum[i + 2] * scale;
  }
  return out;
}

export class Lines {
  constructor(gl, places) {
    this.gl = gl;
    this.count = places.length / 3;
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(places), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
  }
  draw(programs, view, projection, colour) {
    const gl = this.gl, {program, at} = programs.line;
    gl.useProgram(program);
    gl.uniformMatrix4fv(at('view'), false, view);
    gl.uniformMatrix4fv(at('projection'), false, projection);
    gl.uniform3fv(at('colour'), colour);
    gl.bindVertexArray(this.array);
    gl.drawArrays(gl.LINES, 0, this.count);
  }
}

export class Picture {
  constructor(gl) {
    this.gl = gl;
    this.texture = gl.createTexture();
    this.array = gl.createVertexArray();
  }
  set(image) {
    const gl = this.gl;
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
    for (const name of ['WRAP_S', 'WRAP_T']) gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${name}`], gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
  }
  draw(programs) {
    const gl = this.gl;
    gl.useProgram(programs.picture.program);
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    gl.bindVertexArray(this.array);
    gl.depthMask(false);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.depthMask(true);
  }
}

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const unit = a => { const l = Math.hypot(...a) || 1; return a.map(x => x / l); };

// The view from `eye` towards `target`.
export function looking(eye, target, up) {
  const z = unit(eye.map((x, i) => x - target[i])), x = unit(cross(up, z)), y = cross(z, x);
  return [x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, -dot(x, eye), -dot(y, eye), -dot(z, eye), 1];
}

export function perspective(fov, aspect, near, far) {
  const f = 1 / Math.tan(fov / 2);
  return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, 2 * far * near / (near - far), 0];
}

// View and projection of a captured camera (OpenCV's axes), without its distortion.
export function captured({K, T, width, height}, near, far) {
  const view = [];
  for (let c = 0; c < 4; c++) view.push(T[0][c], -T[1][c], -T[2][c], c === 3 ? 1 : 0);
  const projection = [2 * K[0][0] / width, 0, 0, 0, -2 * K[0][1] / width, 2 * K[1][1] / height, 0, 0,
    1 - 2 * K[0][2] / width, 2 * K[1][2] / height - 1, (far + near) / (near - far), -1, 0, 0, 2 * far * near / (near - far), 0];
  return {view, projection};
}

// The corners of a camera's pyramid, `depth` metres long, as pairs of line ends.
export function pyramid({K, T, width, height}, depth) {
  const world = p => [0, 1, 2].map(i => [0, 1, 2].reduce((s, j) => s + T[j][i] * (p[j] - T[j][3]), 0));
  const corner = (u, v) => world([(u - K[0][2]) / K[0][0] * depth, (v - K[1][2]) / K[1][1] * depth, depth]);
  const eye = world([0, 0, 0]), c = [corner(0, 0), corner(width, 0), corner(width, height), corner(0, height)];
  return c.flatMap((p, i) => [...eye, ...p, ...p, ...c[(i + 1) % 4]]);
}
