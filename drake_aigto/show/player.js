// Shows packed Meshcat pages in a frame, with a button to play and pause, and a slider for time.
(() => {
  const find = (id) => document.getElementById(id);
  const frame = find("player-frame"), toggle = find("player-toggle");
  const slider = find("player-slider"), time = find("player-time");
  const buttons = [...document.querySelectorAll("[data-scene]")];
  const MOST_HEIGHT = 560, LEAST_HEIGHT = 180; // of the frame [px]
  const MARGIN = 0.97; // of half a window, that a scene may fill
  const MOST_REACH = 6, MOST_KEYS = 50; // of an object, in half windows; of one of its tracks
  const HOLD = 0.5; // that the end stands before all repeats, which is no time of the motion [s]
  let animator = null, shown = 0, extent = null, seen = "";

  const unpack = async (id) => {
    const packed = Uint8Array.from(atob(find(id).textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).text();
  };

  const load = async (scene) => {
    const number = ++shown;
    animator = extent = null;
    toggle.disabled = slider.disabled = true;
    time.textContent = "loading …";
    buttons.forEach((b) => b.setAttribute("aria-pressed", b.dataset.scene === scene));
    if (typeof DecompressionStream === "undefined") {
      time.textContent = "This browser is too old for the recording: it can't decompress.";
      return;
    }
    const parts = ["scene-start", `scene-${scene}`, "scene-end"].map(unpack);
    const page = (await Promise.all(parts)).join("");
    if (number === shown) {
      frame.srcdoc = page;
      frame.onload = () => wait(number);
    }
  };

  const wait = (number) => {
    if (number !== shown) return;
    const viewer = frame.contentWindow.viewer;
    if (!viewer || !viewer.animator.duration) {
      setTimeout(() => wait(number), 50);
      return;
    }
    animator = viewer.animator;
    slider.max = animator.duration - HOLD;
    toggle.disabled = slider.disabled = false;
    requestAnimationFrame(follow);
  };

  // What is shown from where: meshes and the camera's place come whenever they are ready.
  const describe = ({ camera, controls, scene_tree }) => {
    let count = 0;
    scene_tree.find(["drake_aigto"]).object.traverse((object) => (count += Boolean(object.geometry)));
    return [count, ...camera.position.toArray(), ...controls.target.toArray()].join();
  };

  // The times that show all of a recording: between two keys everything moves straight on.
  const keyTimes = (animator) => {
    const times = new Set([animator.duration]);
    for (const { tracks } of animator.actions.map((action) => action.getClip())) {
      for (const { times: keys } of tracks) {
        const step = Math.ceil(keys.length / MOST_KEYS);
        for (let i = 0; i < keys.length; i += step) times.add(keys[i]);
      }
    }
    return times;
  };

  // How far an object reaches from the middle of the window, across and up, as `seen` has it.
  const reach = (object, seen) => {
    const { min, max } = object.geometry.boundingBox, far = [0, 0];
    const matrix = seen.clone().multiply(object.matrixWorld), corner = min.clone();
    for (let i = 0; i < 8; i++) {
      corner.set(i & 1 ? max.x : min.x, i & 2 ? max.y : min.y, i & 4 ? max.z : min.z);
      corner.applyMatrix4(matrix);
      far[0] = Math.max(far[0], Math.abs(corner.x));
      far[1] = Math.max(far[1], Math.abs(corner.y));
    }
    return far;
  };

  // How far the scene ever reaches, across and up, in half the window's height.
  const measure = ({ animator, camera, controls, scene, scene_tree }) => {
    controls.update(); // A camera that has just been placed turns to its target with the next frame.
    const objects = [], most = [0, 0], now = animator.time;
    scene_tree.find(["drake_aigto"]).object.traverse((object) => {
      if (!object.geometry || object.isSprite) return;
      object.geometry.computeBoundingBox();
      objects.push(object);
    });
    Object.assign(camera, { zoom: 1, aspect: 1 }).updateProjectionMatrix();
    for (const time of keyTimes(animator)) {
      animator.seek(time);
      scene.updateMatrixWorld(true);
      const seen = camera.projectionMatrix.clone().multiply(camera.matrixWorldInverse);
      for (const object of objects) {
        const far = reach(object, seen);
        // What is farther off is ground that goes on and on.
        if (Math.max(...far) < MOST_REACH) far.forEach((x, i) => (most[i] = Math.max(most[i], x)));
      }
    }
    animator.seek(now);
    return most;
  };

  // Gives the frame the height that the scene needs at its width, and shows all of it.
  const fit = () => {
    const viewer = frame.contentWindow && frame.contentWindow.viewer;
    if (!viewer || !animator) return;
    extent = extent || measure(viewer);
    const [across, up] = extent;
    if (!across || !up) return;
    const slim = (frame.clientWidth * up) / across;
    frame.style.height = `${Math.round(Math.min(MOST_HEIGHT, Math.max(LEAST_HEIGHT, slim)))}px`;
    viewer.set_3d_pane_size();
    viewer.camera.zoom = MARGIN / Math.max(across / viewer.camera.aspect, up);
    viewer.camera.updateProjectionMatrix();
    viewer.set_dirty();
  };
  window.addEventListener("resize", fit);

  const follow = () => {
    if (!animator) return;
    const look = describe(frame.contentWindow.viewer);
    if (look !== seen) extent = null;
    seen = look;
    if (!extent) fit();
    if (animator.playing) slider.value = animator.time;
    toggle.textContent = animator.playing ? "❚❚" : "▶";
    const now = `${Number(slider.value).toFixed(2)} s of ${Number(slider.max).toFixed(2)} s`;
    if (time.textContent !== now) time.textContent = now;
    requestAnimationFrame(follow);
  };

  toggle.onclick = () => (animator.playing ? animator.pause() : animator.play());
  slider.oninput = () => {
    animator.pause();
    animator.seek(Number(slider.value));
    animator.display_progress(Number(slider.value));
  };
  buttons.forEach((b) => (b.onclick = () => load(b.dataset.scene)));
  load("0");
})();
