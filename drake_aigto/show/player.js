// Shows packed Meshcat pages in a frame, with a button to play and pause, and a slider for time.
(() => {
  const find = (id) => document.getElementById(id);
  const frame = find("player-frame"), toggle = find("player-toggle");
  const slider = find("player-slider"), time = find("player-time");
  const buttons = [...document.querySelectorAll("[data-scene]")];
  const MOST_HEIGHT = 560, LEAST_HEIGHT = 180; // of the frame [px]
  const MARGIN = 0.97, MOST_REACH = 4; // of a scene, in half windows
  let animator = null, shown = 0;

  // By turns text, and bytes that stand in the page as Base64; each after its length.
  const unpack = async (id) => {
    const packed = Uint8Array.from(atob(find(id).textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    const all = new Uint8Array(await new Response(stream).arrayBuffer());
    const view = new DataView(all.buffer), pieces = [];
    for (let at = 0, isText = true; at < all.length; isText = !isText) {
      const end = at + 4 + view.getUint32(at);
      const piece = all.subarray(at + 4, end);
      pieces.push(isText ? new TextDecoder().decode(piece) : encode(piece));
      at = end;
    }
    return pieces.join("");
  };

  const encode = (bytes) => {
    const letters = [];
    for (let i = 0; i < bytes.length; i += 0x6000) { // A multiple of 3: chunks end with letters.
      letters.push(btoa(String.fromCharCode(...bytes.subarray(i, i + 0x6000))));
    }
    return letters.join("");
  };

  const load = async (scene) => {
    const number = ++shown;
    animator = null;
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
    fit();
    animator = viewer.animator;
    slider.max = animator.duration;
    toggle.disabled = slider.disabled = false;
    requestAnimationFrame(follow);
  };

  // How far the scene reaches from the middle of the window, as a part of half its width and height.
  const reach = (viewer) => {
    const camera = viewer.camera, most = [0, 0];
    camera.zoom = 1;
    camera.updateProjectionMatrix();
    viewer.scene.updateMatrixWorld(true);
    viewer.scene_tree.find(["drake_aigto"]).object.traverse((object) => {
      if (!object.geometry || object.isSprite) return;
      object.geometry.computeBoundingBox();
      const { min, max } = object.geometry.boundingBox;
      const far = [0, 0];
      for (let i = 0; i < 8; i++) {
        const corner = min.clone();
        if (i & 1) corner.x = max.x;
        if (i & 2) corner.y = max.y;
        if (i & 4) corner.z = max.z;
        corner.applyMatrix4(object.matrixWorld).project(camera);
        far[0] = Math.max(far[0], Math.abs(corner.x));
        far[1] = Math.max(far[1], Math.abs(corner.y));
      }
      // What is farther off is ground that goes on and on.
      if (Math.max(...far) < MOST_REACH) far.forEach((x, i) => (most[i] = Math.max(most[i], x)));
    });
    return most;
  };

  // Gives the frame the height that the scene needs at its width, and shows all of it.
  const fit = () => {
    const viewer = frame.contentWindow && frame.contentWindow.viewer;
    if (!viewer) return;
    const [across, up] = reach(viewer);
    if (!across || !up) return;
    const slim = (frame.clientHeight * up) / across;
    frame.style.height = `${Math.round(Math.min(MOST_HEIGHT, Math.max(LEAST_HEIGHT, slim)))}px`;
    viewer.set_3d_pane_size();
    const again = reach(viewer);
    viewer.camera.zoom = MARGIN / Math.max(...again);
    viewer.camera.updateProjectionMatrix();
    viewer.set_dirty();
  };
  window.addEventListener("resize", fit);

  const follow = () => {
    if (!animator) return;
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
