"use strict";
(() => {
  const at = (id) => document.getElementById(id);
  const scene = JSON.parse(at("scene").textContent);
  const bytes = Uint8Array.from(atob(at("data").textContent), (c) => c.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  const all = new Float32Array(bytes.length / 4);
  for (let i = 0; i < all.length; i++) all[i] = view.getFloat32(4 * i, true);
  const part = ([start, length]) => all.subarray(start, start + length);
  const times = part(scene.times), poses = part(scene.poses), planes = part(scene.planes);
  const truth = scene.truth && part(scene.truth);
  const first = times[0], last = times[times.length - 1], count = scene.units.length;

  at("name").textContent = scene.name;
  at("poses-are").textContent = scene.poses_are;
  at("truth-is").textContent = scene.truth_is;
  at("truth-row").hidden = !truth;
  if (matchMedia("(max-width: 560px)").matches) at("legend").open = false;

  const say = (text) => { at("message").textContent = text; at("message").hidden = false; };
  const canvas = at("view");
  const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) {
    at("bar").hidden = at("legend").hidden = true;
    say("This page draws with WebGL 2, which this browser does not offer. Switch hardware acceleration on, or open the page in a current Firefox, Chrome, Edge or Safari.");
    return;
  }
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    say("The graphics processor was reset. Reload the page.");
  });

  // Matrices are columns, as WebGL has them.
  const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => { const n = Math.hypot(...a) || 1; return a.map((v) => v / n); };
  const times4 = (a, b) => {
    const out = new Float32Array(16);
    for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++)
      for (let k = 0; k < 4; k++) out[4 * c + r] += a[4 * k + r] * b[4 * c + k];
    return out;
  };
  const lookAt = (eye, to, up) => {
    const z = unit(sub(eye, to)), x = unit(cross(up, z)), y = cross(z, x);
    return [x[0], y[0], z[0], 0, x[1], y[1], z[1], 0, x[2], y[2], z[2], 0, -dot(x, eye), -dot(y, eye), -dot(z, eye), 1];
  };
  const lens = (angle, aspect, near, far) => {
    const f = 1 / Math.tan(angle / 2);
    return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, 2 * far * near / (near - far), 0];
  };
  const placed = ([x, y, z, i, j, k, w]) => [
    1 - 2 * (j * j + k * k), 2 * (i * j + k * w), 2 * (i * k - j * w), 0,
    2 * (i * j - k * w), 1 - 2 * (i * i + k * k), 2 * (j * k + i * w), 0,
    2 * (i * k + j * w), 2 * (j * k - i * w), 1 - 2 * (i * i + j * j), 0, x, y, z, 1];
  const still = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

  // The pose of a unit between two frames; nothing where it is not there.
  const between = (from, number, frame, share) => {
    const read = (f) => from.subarray(7 * (f * count + number), 7 * (f * count + number) + 7);
    const a = read(frame);
    if (Number.isNaN(a[0])) return null;
    const b = share > 0 ? read(frame + 1) : a;
    if (share <= 0 || Number.isNaN(b[0])) return Array.from(a);
    const sign = a[3] * b[3] + a[4] * b[4] + a[5] * b[5] + a[6] * b[6] < 0 ? -1 : 1;
    const out = Array.from(a, (v, n) => v + ((n > 2 ? sign * b[n] : b[n]) - v) * share);
    const norm = Math.hypot(out[3], out[4], out[5], out[6]) || 1;
    for (let n = 3; n < 7; n++) out[n] /= norm;
    return out;
  };

  const compile = (vertex, fragment) => {
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, "#version 300 es\nprecision highp float;\n" + text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.bindAttribLocation(program, 0, "point");
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) say("The graphics driver refuses a shader: " + gl.getProgramInfoLog(program));
    return new Proxy({}, { get: (known, name) => name === "program" ? program : (known[name] ??= gl.getUniformLocation(program, name)) });
  };
  // Bodies, and their shadows where the plane's normal is not 0.
  const body = compile(
    `in vec3 point; uniform mat4 camera, pose; uniform vec4 plane; uniform float size; out vec3 place;
    const vec3 LIGHT = normalize(vec3(.35, -.45, 1.));
    void main() {
      place = (pose * vec4(point, 1.)).xyz;
      vec3 on = place;
      float slope = dot(plane.xyz, LIGHT);
      if (slope > .05) on -= LIGHT * (dot(plane.xyz, place) - plane.w) / slope;
      gl_Position = camera * vec4(on, 1.);
      gl_PointSize = size;
    }`,
    `in vec3 place; uniform vec4 colour; uniform vec3 eye; uniform float flatness; out vec4 result;
    const vec3 LIGHT = normalize(vec3(.35, -.45, 1.));
    void main() {
      // Points have no surface, and so no normal.
      if (flatness > .9) { result = colour; return; }
      vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
      if (dot(normal, eye - place) < 0.) normal = -normal;
      float light = .5 + .38 * max(dot(normal, LIGHT), 0.) + .16 * normal.z;
      vec3 half_way = normalize(LIGHT + normalize(eye - place));
      float shine = .10 * pow(max(dot(normal, half_way), 0.), 24.);
      result = vec4(mix(colour.rgb * light + shine, colour.rgb, flatness), colour.a);
    }`);
  const ground = compile(
    `in vec3 point; uniform mat4 camera, pose; out vec2 cell;
    void main() { cell = point.xy; gl_Position = camera * pose * vec4(point, 1.); }`,
    `in vec2 cell; uniform vec3 colour, back; uniform float grid, reach; out vec4 result;
    void main() {
      vec2 c = cell / grid, w = fwidth(c), d = abs(fract(c - .5) - .5) / max(w, vec2(1e-6));
      float line = (1. - min(min(d.x, d.y), 1.)) * (1. - smoothstep(.2, .6, max(w.x, w.y)));
      float fade = 1. - smoothstep(reach * .3, reach, length(cell));
      vec3 ink = mix(colour, 1. - colour, .16 * line);
      result = vec4(mix(back, ink, fade), fade);
    }`);

  const mesh = (numbers) => {
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(numbers), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    return { array, length: numbers.length / 3 };
  };
  const looks = scene.units.map((u) => {
    const corners = part(u.corners);
    return {
      surface: mesh(u.triangles.flat().flatMap((c) => Array.from(corners.subarray(3 * c, 3 * c + 3)))),
      points: mesh(part(u.points)),
    };
  });
  const terrain = mesh(part(scene.terrain));
  const reach = 5 * scene.radius;
  const square = mesh([-reach, -reach, 0, reach, -reach, 0, reach, reach, 0, -reach, -reach, 0, reach, reach, 0, -reach, reach, 0]);
  const grid = 10 ** Math.round(Math.log10(scene.radius / 3));
  const floors = [];
  for (let p = 0; p + 3 < planes.length; p += 4) {
    const normal = Array.from(planes.subarray(p, p + 3)), offset = planes[p + 3];
    const high = dot(normal, scene.middle) - offset, place = scene.middle.map((v, n) => v - normal[n] * high);
    const x = unit(cross(Math.abs(normal[0]) < .9 ? [1, 0, 0] : [0, 1, 0], normal).map((v) => -v));
    const y = unit(cross(normal, x));
    floors.push({ plane: [...normal, offset], pose: [...x, 0, ...y, 0, ...normal, 0, ...place, 1] });
  }

  // Camera
  const start = () => ({ turn: -1.0, lift: 0.42, away: 2.1 * scene.radius, to: scene.middle.slice() });
  let cam = start();
  const eyeOf = () => {
    const c = Math.cos(cam.lift);
    // Upright screens see less to the sides.
    const away = cam.away * Math.max(1, .8 * canvas.height / canvas.width);
    return [cam.to[0] + away * c * Math.cos(cam.turn), cam.to[1] + away * c * Math.sin(cam.turn), cam.to[2] + away * Math.sin(cam.lift)];
  };

  // Time
  const speeds = [1, 1 / 2, 1 / 4, 1 / 8, 1 / 16];
  let speed = speeds.findIndex((s) => (last - first) / s >= 2.5), now = first, playing = last > first, before = 0, dirty = true;
  if (speed < 0) speed = speeds.length - 1;
  for (const s of speeds) at("speed").append(new Option(s === 1 ? "1×" : "1/" + 1 / s + "×"));
  const slider = at("time");
  slider.min = first;
  slider.max = last > first ? last : first + 1;
  slider.disabled = !(last > first);
  const frameAt = (t) => {
    let low = 0, high = times.length - 1;
    while (low < high) { const mid = (low + high + 1) >> 1; if (times[mid] <= t) low = mid; else high = mid - 1; }
    const share = low + 1 < times.length ? (t - times[low]) / (times[low + 1] - times[low]) : 0;
    return [low, Math.min(Math.max(share, 0), 1)];
  };

  const rows = scene.units.map((u) => {
    const row = document.createElement("tr"), name = row.insertCell(), dotMark = document.createElement("i");
    dotMark.style.background = "rgb(" + u.colour.map((v) => Math.round(255 * v)) + ")";
    name.append(dotMark, u.name);
    name.title = u.name;
    return { row, off: row.insertCell() };
  });
  const head = document.createElement("tr");
  head.innerHTML = "<th>unit</th><th></th>";
  at("units").append(head, ...rows.map((r) => r.row));

  const shown = () => ({ poses: at("show-poses").checked, truth: truth && at("show-truth").checked, points: at("show-points").checked });
  const rgb = (name) => {
    const hex = getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    return [1, 3, 5].map((n) => parseInt(hex.slice(n, n + 2), 16) / 255);
  };

  const draw = () => {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((v) => Math.max(1, Math.round(v * ratio)));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const back = rgb("--back"), isDark = back[0] < .5, [frame, share] = frameAt(now), show = shown(), eye = eyeOf();
    const camera = times4(lens(.75, width / height, scene.radius * .02, scene.radius * 60), lookAt(eye, cam.to, [0, 0, 1]));
    gl.viewport(0, 0, width, height);
    gl.clearColor(...back, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.disable(gl.CULL_FACE);
    const soil = back.map((v) => isDark ? v + .07 : v - .05), shade = soil.map((v) => v * (isDark ? .55 : .8));

    gl.useProgram(ground.program);
    gl.uniformMatrix4fv(ground.camera, false, camera);
    gl.uniform3fv(ground.colour, soil);
    gl.uniform3fv(ground.back, back);
    gl.uniform1f(ground.grid, grid);
    gl.uniform1f(ground.reach, reach);
    gl.bindVertexArray(square.array);
    // Depth comes from bodies alone: what lies on a plane would fight with it.
    gl.depthMask(false);
    for (const floor of floors) {
      const [a, b, c, d] = floor.plane;
      if (dot([a, b, c], eye) < d) continue;
      gl.uniformMatrix4fv(ground.pose, false, floor.pose);
      gl.drawArrays(gl.TRIANGLES, 0, square.length);
    }

    gl.useProgram(body.program);
    gl.uniformMatrix4fv(body.camera, false, camera);
    gl.uniform3fv(body.eye, eye);
    gl.uniform1f(body.size, 3.5 * ratio);
    const paint = (model, colour, alpha, plane, kind, mode, flatness) => {
      gl.uniform4fv(body.plane, plane);
      gl.uniform1f(body.flatness, flatness);
      model.forEach((pose, number) => {
        const what = looks[number][kind];
        if (!pose || !what.length) return;
        gl.uniformMatrix4fv(body.pose, false, pose);
        gl.uniform4fv(body.colour, [...(colour || scene.units[number].colour), alpha]);
        gl.bindVertexArray(what.array);
        gl.drawArrays(mode, 0, what.length);
      });
    };
    const posed = (from) => scene.units.map((_, number) => between(from, number, frame, share));
    const ours = posed(poses), theirs = truth ? posed(truth) : [];
    const models = (list) => list.map((pose) => pose && placed(pose));
    const none = [0, 0, 0, 0], mine = models(ours), real = models(theirs);
    const casts = show.poses ? mine : show.truth ? real : [];
    for (const floor of floors) {
      const [a, b, c, d] = floor.plane;
      if (c > .5 && dot([a, b, c], eye) > d) paint(casts, shade, 1, floor.plane, "surface", gl.TRIANGLES, 1);
    }
    gl.depthMask(true);
    if (terrain.length) {
      gl.uniform4fv(body.plane, none);
      gl.uniform1f(body.flatness, 0);
      gl.uniformMatrix4fv(body.pose, false, still);
      gl.uniform4fv(body.colour, [...soil, 1]);
      gl.bindVertexArray(terrain.array);
      gl.drawArrays(gl.TRIANGLES, 0, terrain.length);
    }
    if (show.poses && !show.points) paint(mine, null, 1, none, "surface", gl.TRIANGLES, 0);
    if (show.points) {
      if (show.poses) paint(mine, null, 1, none, "points", gl.POINTS, 1);
      if (show.truth) paint(real, null, .5, none, "points", gl.POINTS, 1);
    }
    // Units without volume have no surface.
    looks.forEach((look, number) => {
      if (look.surface.length || show.points || !show.poses) return;
      paint(mine.map((m, n) => n === number ? m : null), null, 1, none, "points", gl.POINTS, 1);
    });
    if (show.truth) {
      // The nearest faces alone, so that a body is one veil.
      gl.enable(gl.CULL_FACE);
      gl.depthMask(false);
      paint(real, null, show.poses ? .38 : .9, none, "surface", gl.TRIANGLES, .25);
      gl.depthMask(true);
    }
    gl.bindVertexArray(null);

    const long = (last - first) >= 100 ? 1 : 3;
    at("now").textContent = now.toFixed(long) + " / " + last.toFixed(long) + " s";
    slider.value = now;
    at("play").className = playing ? "playing" : "";
    at("speed").selectedIndex = speed;
    rows.forEach((row, number) => {
      const a = ours[number], b = theirs[number];
      row.off.textContent = a && b && scene.units[number].free ? (100 * Math.hypot(...sub(a, b))).toFixed(1) + " cm" : "";
      row.row.style.opacity = a || b ? 1 : .4;
    });
    head.cells[1].textContent = rows.some((row) => row.off.textContent) ? "apart" : "";
  };

  const loop = (stamp) => {
    if (playing) {
      now += Math.min((stamp - before) / 1000, .1) * speeds[speed];
      // A moment's rest at the end.
      if (now > last + .6 * speeds[speed]) now = first;
      dirty = true;
    }
    before = stamp;
    if (dirty) {
      dirty = false;
      const t = now;
      now = Math.min(now, last);
      draw();
      if (playing) now = t;
    }
    requestAnimationFrame(loop);
  };
  const redraw = () => { dirty = true; };
  const seek = (t) => { now = Math.min(Math.max(t, first), last); playing = false; redraw(); };
  const toggle = () => {
    if (!(last > first)) return;
    playing = !playing;
    if (playing && now >= last) now = first;
    redraw();
  };
  const step = (way) => {
    const [frame, share] = frameAt(Math.min(now, last));
    const to = way > 0 ? frame + 1 : share > 1e-4 ? frame : frame - 1;
    seek(times[Math.min(Math.max(to, 0), times.length - 1)]);
  };
  const flip = (id) => { at(id).checked = !at(id).checked; redraw(); };
  const faster = (way) => { speed = Math.min(Math.max(speed - way, 0), speeds.length - 1); redraw(); };

  at("play").onclick = toggle;
  slider.oninput = () => seek(+slider.value);
  at("speed").onchange = () => { speed = at("speed").selectedIndex; };
  for (const id of ["show-poses", "show-truth", "show-points"]) at(id).onchange = redraw;
  addEventListener("resize", redraw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
    const keys = {
      " ": toggle, ArrowLeft: () => step(-1), ArrowRight: () => step(1), Home: () => seek(first), End: () => seek(last),
      p: () => flip("show-poses"), t: () => truth && flip("show-truth"), d: () => flip("show-points"),
      r: () => { cam = start(); redraw(); }, "+": () => faster(1), "=": () => faster(1), "-": () => faster(-1),
    };
    const act = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });

  // Mouse and touch
  const fingers = new Map();
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, d: Math.hypot(a.x - b.x, a.y - b.y) };
  };
  const zoom = (by) => { cam.away = Math.min(Math.max(cam.away * by, scene.radius * .2), scene.radius * 20); };
  const shift = (dx, dy) => {
    const eye = eyeOf(), z = unit(sub(eye, cam.to)), x = unit(cross([0, 0, 1], z)), y = cross(z, x);
    const scale = .8 * Math.hypot(...sub(eye, cam.to)) / canvas.clientHeight;
    cam.to = cam.to.map((v, n) => v - scale * (dx * x[n] - dy * y[n]));
  };
  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  };
  canvas.onpointermove = (event) => {
    const finger = fingers.get(event.pointerId);
    if (!finger) return;
    const dx = event.clientX - finger.x, dy = event.clientY - finger.y;
    const old = fingers.size === 2 && spread();
    finger.x = event.clientX;
    finger.y = event.clientY;
    if (old) {
      const next = spread();
      if (next.d > 0) zoom(old.d / next.d);
      shift(next.x - old.x, next.y - old.y);
    } else if (event.buttons & 2 || event.shiftKey) {
      shift(dx, dy);
    } else {
      cam.turn -= dx * .008;
      cam.lift = Math.min(Math.max(cam.lift + dy * .008, -1.5), 1.5);
    }
    redraw();
  };
  canvas.onpointerup = canvas.onpointercancel = (event) => fingers.delete(event.pointerId);
  canvas.oncontextmenu = (event) => event.preventDefault();
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(Math.max(-60, Math.min(60, event.deltaY)) * .004));
    redraw();
  }, { passive: false });

  // A page that is opened with #t=0.3 stands still there.
  const asked = /^#t=([\d.]+)$/.exec(location.hash);
  if (asked && Number.isFinite(+asked[1])) seek(+asked[1]);
  requestAnimationFrame(loop);
})();
