// Shows packed Meshcat pages in a frame, with a button to play and pause, and a slider for time.
(() => {
  const find = (id) => document.getElementById(id);
  const frame = find("player-frame"), toggle = find("player-toggle");
  const slider = find("player-slider"), time = find("player-time");
  const buttons = [...document.querySelectorAll("[data-scene]")];
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
    animator = viewer.animator;
    slider.max = animator.duration;
    toggle.disabled = slider.disabled = false;
    requestAnimationFrame(follow);
  };

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
