"use strict";
/* Replay of rigid bodies on a 2-D canvas, without a GPU: convex hulls are culled, lit per triangle and painted from back
   to front. World axes: z up; lengths in m; quaternions x, y, z, w. */
const Replay = (() => {
  const LIGHT = unit([0.75, -0.25, 1.0]);  // towards the light
  const FIELD = 0.36;                      // half picture height / distance

  function unit(a) { const n = Math.hypot(...a) || 1; return a.map(x => x / n); }
  function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
  function cross(a, b) {
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  }

  /** Decode base64 of little-endian numbers. */
  function decode(text, Kind) {
    return new Kind(Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer);
  }

  /** Rotation matrix of a quaternion, row-major. */
  function rotation(x, y, z, w) {
    const s = 2 / (x * x + y * y + z * z + w * w);
    return [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w),
            s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w),
            s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)];
  }

  function act(pose, a) {
    const [R, p] = [pose.R, pose.p];
    return [R[0] * a[0] + R[1] * a[1] + R[2] * a[2] + p[0], R[3] * a[0] + R[4] * a[1] + R[5] * a[2] + p[1],
            R[6] * a[0] + R[7] * a[1] + R[8] * a[2] + p[2]];
  }

  /** Rotate into the frame of a pose. */
  function inverseRotate(pose, a) {
    const R = pose.R;
    return [R[0] * a[0] + R[3] * a[1] + R[6] * a[2], R[1] * a[0] + R[4] * a[1] + R[7] * a[2],
            R[2] * a[0] + R[5] * a[1] + R[8] * a[2]];
  }

  /** Convex hull of points in the plane, counter-clockwise (Andrew's monotone chain). */
  function hull(points) {
    const sorted = points.slice().sort((a, b) => a[0] - b[0] || a[1] - b[1]);
    if (sorted.length < 3) return sorted;
    const turn = (o, a, b) => (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]);
    const half = list => {
      const chain = [];
      for (const p of list) {
        while (chain.length > 1 && turn(chain[chain.length - 2], chain[chain.length - 1], p) <= 0) chain.pop();
        chain.push(p);
      }
      chain.pop();
      return chain;
    };
    return half(sorted).concat(half(sorted.reverse()));
  }

  /** Frame before a time, and interpolation weight of the next one. */
  function locate(times, t) {
    let low = 0, high = times.length - 1;
    if (t >= times[high]) return [high, 0];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] <= t) low = middle; else high = middle;
    }
    return [low, Math.max(0, (t - times[low]) / (times[high] - times[low] || 1))];
  }

  /** Bisect long edges: long triangles cannot be sorted by depth. */
  function subdivide(vertices, triangles, longest) {
    const v = vertices.slice(), open = [], done = [], middles = new Map();
    const length = (i, j) => Math.hypot(v[3 * i] - v[3 * j], v[3 * i + 1] - v[3 * j + 1], v[3 * i + 2] - v[3 * j + 2]);
    const middle = (i, j) => {
      const key = i < j ? i + "," + j : j + "," + i;
      if (!middles.has(key)) {
        middles.set(key, v.length / 3);
        for (let k = 0; k < 3; k++) v.push((v[3 * i + k] + v[3 * j + k]) / 2);
      }
      return middles.get(key);
    };
    for (let k = 0; k < triangles.length; k += 3) open.push(triangles.slice(k, k + 3));
    while (open.length) {
      let [a, b, c] = open.pop();
      const [ab, bc, ca] = [length(a, b), length(b, c), length(c, a)], most = Math.max(ab, bc, ca);
      if (most <= longest) { done.push(a, b, c); continue; }
      if (most === bc) [a, b, c] = [b, c, a]; else if (most === ca) [a, b, c] = [c, a, b];
      const m = middle(a, b);
      open.push([a, m, c], [m, b, c]);
    }
    return [Float32Array.from(v), Uint16Array.from(done)];
  }

  class Scene {
    constructor(data) {
      this.times = decode(data.time, Float32Array);
      this.packed = decode(data.poses.data, Int16Array);
      this.poses = data.poses;
      this.joints = data.joints;
      this.forces = decode(data.forces, Float32Array);
      this.com = decode(data.com, Float32Array);
      this.contacts = data.contacts;
      this.metresPerNewton = 0.42 * data.size / data.weight;
      this.parts = data.parts.map(part => {
        const [v, t] = subdivide(part.vertices, part.triangles, 0.06 * data.size);
        const at = i => [v[3 * i], v[3 * i + 1], v[3 * i + 2]];
        const normals = new Float32Array(t.length);
        const reach = new Float32Array(t.length / 3);  // distance of the plane along its normal
        for (let k = 0; k < t.length; k += 3) {
          const [a, b, c] = [at(t[k]), at(t[k + 1]), at(t[k + 2])];
          const n = unit(cross(b.map((x, i) => x - a[i]), c.map((x, i) => x - a[i])));
          normals.set(n, k);
          reach[k / 3] = dot(n, a);
        }
        const outline = part.vertices.length;  // without corners of the subdivision
        return { joint: part.joint, color: part.color, v, t, outline, normals, reach, screen: new Float32Array(v.length) };
      });
      // Initial camera: the whole robot in the first frame.
      const first = this.at(this.times[0]);
      const low = [Infinity, Infinity, 0], high = [-Infinity, -Infinity, 0.3];
      for (const part of this.parts) {
        for (let k = 0; k < part.v.length; k += 3) {
          const p = act(first.poses[part.joint], [part.v[k], part.v[k + 1], part.v[k + 2]]);
          for (let i = 0; i < 3; i++) { low[i] = Math.min(low[i], p[i]); high[i] = Math.max(high[i], p[i]); }
        }
      }
      this.size = data.size;
      this.height = high[2];
      this.center = [(low[0] + high[0]) / 2 - first.com[0], (low[1] + high[1]) / 2 - first.com[1]];
    }

    /** Interpolated poses, forces and centre of mass at a time. */
    at(time) {
      const [frame, share] = locate(this.times, time);
      const next = Math.min(frame + 1, this.times.length - 1);
      const { center, scale } = this.poses;
      const poses = [];
      for (let j = 0; j < this.joints; j++) {
        const a = 7 * (frame * this.joints + j), b = 7 * (next * this.joints + j);
        const x = center.map((c, i) => c + scale[i] * ((1 - share) * this.packed[a + i] + share * this.packed[b + i]));
        poses.push({ p: x.slice(0, 3), R: rotation(x[3], x[4], x[5], x[6]) });
      }
      const n = this.contacts.length;
      const forces = this.contacts.map((contact, i) => {
        const row = this.forces.subarray(12 * (frame * n + i), 12 * (frame * n + i + 1));
        return { planned: [...row.subarray(0, 6)], true: [...row.subarray(6, 12)] };
      });
      const com = [...this.com.subarray(6 * frame, 6 * frame + 6)];
      return { poses, forces, com };
    }
  }

  class View {
    constructor(canvas, scene) {
      this.canvas = canvas;
      this.scene = scene;
      this.show = { planned: true, true: true, com: true };
      this.reset();
    }

    reset() {
      Object.assign(this, { azimuth: 0.62, elevation: 0.2, zoom: 1 });
      this.focus = null;
    }

    /** Rotate with the pointer and zoom with the wheel; `changed` is called after each change. */
    steer(changed) {
      const canvas = this.canvas;
      canvas.addEventListener("pointerdown", event => canvas.setPointerCapture(event.pointerId));
      canvas.addEventListener("pointermove", event => {
        if (!canvas.hasPointerCapture(event.pointerId)) return;
        this.azimuth -= 0.008 * event.movementX;
        this.elevation = Math.min(1.5, Math.max(0.02, this.elevation + 0.006 * event.movementY));
        changed();
      });
      canvas.addEventListener("wheel", event => {
        event.preventDefault();
        this.zoom = Math.min(4, Math.max(0.4, this.zoom * Math.exp(-0.0012 * event.deltaY)));
        changed();
      }, { passive: false });
    }

    /** Place the camera: it follows large displacements only. */
    aim(com, width, height) {
      const scene = this.scene;
      const goal = [com[0] + scene.center[0], com[1] + scene.center[1]];
      if (!this.focus) this.focus = goal;
      const far = Math.hypot(goal[0] - this.focus[0], goal[1] - this.focus[1]);
      if (far > 0.25) {
        const pull = 1 - 0.25 / far;
        this.focus = this.focus.map((x, i) => x + pull * (goal[i] - x));
      }
      const room = Math.max(0.66 * scene.height, 0.48 * scene.size, 0.48 * scene.size * height / width);
      const distance = room / FIELD / this.zoom;
      const [ca, sa, ce, se] = [Math.cos(this.azimuth), Math.sin(this.azimuth), Math.cos(this.elevation),
                                Math.sin(this.elevation)];
      const target = [this.focus[0], this.focus[1], scene.height * 0.49];
      this.back = [ce * ca, ce * sa, se];
      this.right = [-sa, ca, 0];
      this.up = cross(this.back, this.right);
      this.eye = target.map((x, i) => x + distance * this.back[i]);
      this.focal = height / 2 / FIELD;
      this.middle = [width / 2, height / 2];
      this.disc = scene.size * 0.95;
    }

    /** Picture coordinates and depth of a point; null behind the camera. */
    project(a) {
      const d = [a[0] - this.eye[0], a[1] - this.eye[1], a[2] - this.eye[2]];
      const depth = -dot(d, this.back);
      if (depth < 0.05) return null;
      const s = this.focal / depth;
      return [this.middle[0] + s * dot(d, this.right), this.middle[1] - s * dot(d, this.up), depth];
    }

    draw(time) {
      const { canvas, scene } = this;
      const ratio = Math.min(window.devicePixelRatio || 1, 2);
      const width = canvas.clientWidth, height = canvas.clientHeight;
      if (!width || !height) return;
      if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(height * ratio);
      }
      const style = getComputedStyle(document.documentElement);
      const color = name => style.getPropertyValue("--" + name).trim();
      const ink = this.ink = canvas.getContext("2d");
      ink.setTransform(ratio, 0, 0, ratio, 0, 0);
      ink.clearRect(0, 0, width, height);
      ink.lineJoin = ink.lineCap = "round";
      const now = scene.at(time);
      this.aim(now.com, width, height);
      this.floor(color);
      this.shadow(now, color("shadow"));
      this.support(now, color("planned"));
      if (this.show.com) this.plumb(now.com, color("com"));
      this.bodies(now);
      if (this.show.com) this.mass(now.com, color("com"), color("card"));
      for (const force of now.forces) {
        if (this.show.true) this.arrow(force.true, color("true"), 6, 0.85);
        if (this.show.planned) this.arrow(force.planned, color("planned"), 2.6, 1);
      }
    }

    path(points, close) {
      const ink = this.ink;
      points.forEach((p, i) => (i ? ink.lineTo(p[0], p[1]) : ink.moveTo(p[0], p[1])));
      if (close) ink.closePath();
    }

    /** Add a flat polygon, clipped at the near plane, to the path. */
    polygon(corners) {
      const near = 0.06, depth = a => -a.reduce((sum, x, i) => sum + (x - this.eye[i]) * this.back[i], 0);
      const kept = [];
      corners.forEach((a, i) => {
        const b = corners[(i + 1) % corners.length], [da, db] = [depth(a), depth(b)];
        if (da >= near) kept.push(a);
        if ((da >= near) !== (db >= near)) kept.push(a.map((x, k) => x + (b[k] - x) * (near - da) / (db - da)));
      });
      this.path(kept.map(a => this.project(a)), true);
    }

    /** Disc around the robot with grid lines at whole and quarter metres. */
    floor(color) {
      const ink = this.ink, r = this.disc, [cx, cy] = this.focus;
      const rim = Array.from({ length: 72 }, (_, i) => {
        const angle = i * Math.PI / 36;
        return [cx + r * Math.cos(angle), cy + r * Math.sin(angle), 0];
      });
      ink.beginPath();
      this.polygon(rim);
      ink.fillStyle = color("floor");
      ink.fill();
      for (const strong of [false, true]) {
        ink.beginPath();
        for (const axis of [0, 1]) {
          const c = this.focus[axis], o = this.focus[1 - axis];
          for (let k = Math.ceil((c - r) * 4); k <= (c + r) * 4; k++) {
            if ((k % 4 === 0) !== strong) continue;
            const half = Math.sqrt(Math.max(0, r * r - (k / 4 - c) ** 2));
            const ends = [o - half, o + half].map(e => (axis ? [e, k / 4, 0] : [k / 4, e, 0]));
            this.polygon(ends);
          }
        }
        ink.strokeStyle = color(strong ? "floor-strong" : "floor-line");
        ink.lineWidth = 1;
        ink.stroke();
      }
    }

    /** Shadows as one path of convex hulls, so that overlaps are not darker. */
    shadow(now, style) {
      const ink = this.ink;
      ink.beginPath();
      for (const part of this.scene.parts) {
        const pose = now.poses[part.joint], points = [];
        for (let k = 0; k < part.outline; k += 3) {
          const a = act(pose, [part.v[k], part.v[k + 1], part.v[k + 2]]);
          const s = Math.max(a[2], 0) / LIGHT[2];
          const p = this.project([a[0] - s * LIGHT[0], a[1] - s * LIGHT[1], 0]);
          if (p) points.push(p);
        }
        this.path(hull(points), true);
      }
      ink.fillStyle = style;
      ink.fill("nonzero");
    }

    /** Support polygon of loaded contacts. */
    support(now, style) {
      const ink = this.ink, corners = [];
      this.scene.contacts.forEach((contact, i) => {
        if (Math.hypot(...now.forces[i].planned.slice(3)) < 1) return;
        for (const corner of contact.corners) corners.push(act(now.poses[contact.joint], corner));
      });
      if (corners.length < 3) return;
      ink.beginPath();
      this.polygon(hull(corners).map(c => [c[0], c[1], 0]));
      ink.fillStyle = ink.strokeStyle = style;
      ink.lineWidth = 1.5;
      ink.globalAlpha = 0.16;
      ink.fill();
      ink.globalAlpha = 0.8;
      ink.stroke();
      ink.globalAlpha = 1;
    }

    bodies(now) {
      const ink = this.ink, { eye, back, right, up, focal, middle } = this;
      const drawn = [];
      for (const part of this.scene.parts) {
        const pose = now.poses[part.joint], { v, t, normals, reach, screen } = part;
        for (let k = 0; k < v.length; k += 3) {
          const a = act(pose, [v[k], v[k + 1], v[k + 2]]);
          const x = a[0] - eye[0], y = a[1] - eye[1], z = a[2] - eye[2];
          const depth = -(x * back[0] + y * back[1] + z * back[2]), s = focal / depth;
          screen[k] = middle[0] + s * (x * right[0] + y * right[1] + z * right[2]);
          screen[k + 1] = middle[1] - s * (x * up[0] + y * up[1] + z * up[2]);
          screen[k + 2] = depth;
        }
        // Light and eye in the body's frame, in place of rotated normals.
        const light = inverseRotate(pose, LIGHT), sky = inverseRotate(pose, [0, 0, 1]);
        const from = inverseRotate(pose, [eye[0] - pose.p[0], eye[1] - pose.p[1], eye[2] - pose.p[2]]);
        for (let k = 0; k < t.length; k += 3) {
          const nx = normals[k], ny = normals[k + 1], nz = normals[k + 2];
          if (nx * from[0] + ny * from[1] + nz * from[2] <= reach[k / 3]) continue;
          const [i, j, l] = [3 * t[k], 3 * t[k + 1], 3 * t[k + 2]];
          if (Math.min(screen[i + 2], screen[j + 2], screen[l + 2]) < 0.05) continue;
          const lit = Math.max(0, nx * light[0] + ny * light[1] + nz * light[2]);
          const above = 0.5 + 0.5 * (nx * sky[0] + ny * sky[1] + nz * sky[2]);
          drawn.push({ depth: screen[i + 2] + screen[j + 2] + screen[l + 2], screen, i, j, l, color: part.color,
                       shade: 0.35 + 0.25 * above + 0.44 * lit });
        }
      }
      drawn.sort((a, b) => b.depth - a.depth);
      ink.lineWidth = 0.8;
      for (const { screen, i, j, l, color, shade } of drawn) {
        // Black is brightened to show shapes.
        const c = color.map(x => Math.min(255, Math.round((34 + 0.87 * x) * shade)));
        ink.fillStyle = ink.strokeStyle = `rgb(${c[0]},${c[1]},${c[2]})`;
        ink.beginPath();
        ink.moveTo(screen[i], screen[i + 1]);
        ink.lineTo(screen[j], screen[j + 1]);
        ink.lineTo(screen[l], screen[l + 1]);
        ink.closePath();
        ink.fill();
        ink.stroke();  // closes gaps of anti-aliasing
      }
    }

    arrow(line, style, thickness, alpha) {
      const force = line.slice(3);
      if (Math.hypot(...force) < 1) return;
      const start = this.project(line.slice(0, 3));
      const end = this.project(force.map((f, i) => line[i] + f * this.scene.metresPerNewton));
      if (!start || !end) return;
      const ink = this.ink, length = Math.hypot(end[0] - start[0], end[1] - start[1]);
      const head = Math.min(4 + 2.6 * thickness, 0.6 * length);
      const [x, y] = [(end[0] - start[0]) / (length || 1), (end[1] - start[1]) / (length || 1)];
      const neck = [end[0] - head * x, end[1] - head * y];
      ink.globalAlpha = alpha;
      ink.strokeStyle = ink.fillStyle = style;
      ink.lineWidth = thickness;
      ink.beginPath();
      this.path([start, neck]);
      ink.stroke();
      ink.beginPath();
      this.path([end, [neck[0] - 0.5 * head * y, neck[1] + 0.5 * head * x],
                 [neck[0] + 0.5 * head * y, neck[1] - 0.5 * head * x]], true);
      ink.fill();
      ink.globalAlpha = 1;
    }

    /** Centre of mass on the floor (dot), and its reference (ring). */
    plumb(com, style) {
      const ink = this.ink;
      const ring = (x, y, r) => {
        ink.beginPath();
        this.polygon(Array.from({ length: 24 }, (_, i) => [x + r * Math.cos(i * Math.PI / 12),
                                                          y + r * Math.sin(i * Math.PI / 12), 0]));
      };
      ink.fillStyle = ink.strokeStyle = style;
      ring(com[0], com[1], 0.014);
      ink.fill();
      if (Number.isFinite(com[3]) && Number.isFinite(com[4])) {
        ring(com[3], com[4], 0.028);
        ink.lineWidth = 1.5;
        ink.stroke();
      }
    }

    mass(com, style, rim) {
      const ink = this.ink, top = this.project(com.slice(0, 3)), foot = this.project([com[0], com[1], 0]);
      if (!top || !foot) return;
      ink.strokeStyle = ink.fillStyle = style;
      ink.lineWidth = 1.2;
      ink.setLineDash([3, 4]);
      ink.beginPath();
      this.path([top, foot]);
      ink.stroke();
      ink.setLineDash([]);
      ink.beginPath();
      ink.arc(top[0], top[1], 5.5, 0, 2 * Math.PI);
      ink.fill();
      ink.lineWidth = 1.5;
      ink.strokeStyle = rim;
      ink.stroke();
    }
  }

  return { Scene, View, decode, rotation, hull, locate, subdivide };
})();
if (typeof module === "object" && module.exports) module.exports = Replay;
