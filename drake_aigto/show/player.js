// Shows packed Meshcat pages in a frame, with what is said of them beside it, a slider for time with
// events on it, speed, frame steps and keys; figures over time follow it, and lead it.
(() => {
  const find = (id) => document.getElementById(id);
  const frame = find("player-frame"), toggle = find("player-toggle"), player = frame.closest(".player");
  const slider = find("player-slider"), time = find("player-time"), aside = find("player-aside");
  const buttons = [...document.querySelectorAll("[data-scene]")];
  const scenes = JSON.parse(find("player-beside").textContent);
  const MOST_HEIGHT = 600, LEAST_HEIGHT = 150; // of the frame [px]
  const MARGIN = 0.97; // of half a window, that a scene may fill
  const HOLD = 0.5; // that the end stands before all repeats, which is no time of the motion [s]
  const STEP = 0.01; // of a frame [s]
  const DARK_STAGE = [0.66, 0.68, 0.71], LIGHT_STAGE = [1, 1, 1]; // behind the scene
  const dark = matchMedia("(prefers-color-scheme: dark)");
  let animator = null, shown = 0, beside = scenes[0], told = -1;
  let plots = []; // axes over time, in figures of the page

  const unpack = async (id) => {
    const packed = Uint8Array.from(atob(find(id).textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).text();
  };

  const add = (parent, tag, text, look = {}) => {
    const made = parent.appendChild(document.createElement(tag));
    made.textContent = text;
    return Object.assign(made, look);
  };

  // Says beside the scene, and on the slider, what there is to see.
  const tell = () => {
    const legend = find("player-legend"), marks = find("player-marks"), list = find("player-events");
    [legend, marks, list, find("player-numbers")].forEach((each) => each.replaceChildren());
    const { motions = [], notes = [], events = [], numbers } = beside;
    motions.forEach(([color, text], i) => {
      add(legend, "li", text, { className: i ? "ghost" : "solid" }).style.setProperty("--color", color);
    });
    notes.forEach(([color, text]) => add(legend, "li", text).style.setProperty("--color", color));
    for (const [at, text, kind] of events) {
      const mark = add(marks, "i", "", { className: kind, title: `${at.toFixed(2)} s: ${text}` });
      mark.style.left = `${(100 * at) / Number(slider.max)}%`;
      const button = add(list, "button", `${at.toFixed(2)} s ${text}`, { type: "button" });
      button.onclick = () => seek(at);
    }
    for (const name of numbers ? numbers.names : []) {
      const row = find("player-numbers").insertRow();
      add(row, "th", name);
      add(row, "td", "");
    }
    aside.hidden = motions.length < 2;
    buttons.forEach((b) => (b.hidden = buttons.length < 2));
    told = -1;
  };

  const load = async (scene) => {
    const number = ++shown;
    animator = null;
    beside = scenes[scene];
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
    frame.contentWindow.addEventListener("keydown", press);
    add(frame.contentDocument.head, "style", ".dg { display: none }"); // Meshcat's bar over the scene
    tell();
    arrange();
    requestAnimationFrame(follow);
  };

  // Stands motions side by side, each in its world, or all in one place, all but the first as ghosts.
  const arrange = () => {
    const viewer = frame.contentWindow.viewer, isAside = aside.getAttribute("aria-pressed") === "true";
    (beside.aside || []).forEach(([x, y, z], i) => {
      for (const kind of ["motions", "worlds", "ghosts"]) {
        const group = viewer.scene_tree.find(["drake_aigto", kind, `${i + 1}`]).object;
        group.position.set(...(isAside ? [x, y, z] : [0, 0, 0]));
        group.updateMatrix();
      }
      for (const path of i ? beside.without : []) {
        const parts = ["drake_aigto", ...path.replace("{}", i + 1).split("/")];
        viewer.scene_tree.find(parts).object.visible = isAside;
      }
    });
    const ground = dark.matches ? DARK_STAGE : LIGHT_STAGE;
    for (const end of ["top_color", "bottom_color"]) {
      viewer.set_property(["Background", "<object>"], end, ground);
    }
    viewer.set_property(["Background"], "visible", true);
    fit();
  };

  // Gives the frame the height that the scene needs at its width, and shows all of it.
  const fit = () => {
    const viewer = frame.contentWindow && frame.contentWindow.viewer;
    if (!viewer || !animator) return;
    const [one, all] = beside.reach, [across, up] = aside.getAttribute("aria-pressed") === "true" ? all : one;
    const text = frame.nextElementSibling, isBeside = text.offsetTop === frame.offsetTop;
    const least = Math.max(LEAST_HEIGHT, isBeside ? text.offsetHeight : 0);
    const height = Math.max(least, Math.min(MOST_HEIGHT, (frame.clientWidth * up) / across));
    if (frame.clientHeight !== Math.round(height)) {
      frame.style.height = `${Math.round(height)}px`;
      viewer.set_3d_pane_size();
    }
    const zoom = MARGIN / Math.max(across / viewer.camera.aspect, up);
    if (viewer.camera.zoom === zoom) return;
    viewer.camera.zoom = zoom;
    viewer.camera.updateProjectionMatrix();
    viewer.set_dirty();
  };

  // Shows numbers and cursors of a time, which is another one.
  const point = (now) => {
    if (now === told) return;
    told = now;
    time.textContent = `${now.toFixed(2)} s of ${Number(slider.max).toFixed(2)} s`;
    const { times = [], columns = [] } = beside.numbers || {};
    const row = times.reduce((best, t, i) => (t <= now + 1e-9 ? i : best), 0);
    [...find("player-numbers").rows].forEach((each, i) => (each.cells[1].textContent = columns[i][row].toPrecision(3)));
    for (const plot of plots) {
      const part = (now - plot.dataset.first) / (plot.dataset.last - plot.dataset.first);
      plot.firstElementChild.style.left = `${100 * part}%`;
      plot.firstElementChild.hidden = part < 0 || part > 1;
    }
  };

  const follow = () => {
    if (!animator) return;
    fit();
    if (animator.playing) slider.value = animator.time;
    const speed = Number(find("player-speed").value);
    animator.actions.forEach((action) => (action.timeScale = speed));
    const sign = animator.playing ? "❚❚" : "▶";
    if (toggle.textContent !== sign) toggle.textContent = sign;
    point(Number(slider.value));
    requestAnimationFrame(follow);
  };

  const seek = (to) => {
    if (!animator) return;
    slider.value = to;
    animator.pause();
    animator.seek(Number(slider.value));
    animator.display_progress(Number(slider.value));
  };

  // From event to event; where there is none further, to an end.
  const leap = (way) => {
    const now = Number(slider.value), times = [0, ...(beside.events || []).map(([t]) => t), Number(slider.max)];
    const further = times.filter((t) => way * (t - now) > 1e-3);
    if (further.length) seek(way > 0 ? Math.min(...further) : Math.max(...further));
  };

  const press = (event) => {
    if (["SELECT", "INPUT"].includes(event.target.tagName) && event.target !== slider) return;
    const way = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (way && event.shiftKey) leap(way);
    else if (way) seek(Number(slider.value) + way * STEP);
    else if (event.key === " " && event.target.tagName !== "BUTTON") toggle.click();
    else if (event.key === "Home" || event.key === "End") seek(event.key === "End" ? slider.max : 0);
    else return;
    event.preventDefault();
  };

  player.addEventListener("keydown", press);
  window.addEventListener("resize", fit);
  dark.addEventListener("change", () => animator && arrange());
  toggle.onclick = () => animator && (animator.playing ? animator.pause() : animator.play());
  find("player-back").onclick = () => seek(Number(slider.value) - STEP);
  find("player-ahead").onclick = () => seek(Number(slider.value) + STEP);
  slider.oninput = () => seek(slider.value);
  aside.onclick = () => {
    aside.setAttribute("aria-pressed", aside.getAttribute("aria-pressed") !== "true");
    arrange();
  };
  window.addEventListener("load", () => {
    plots = [...document.querySelectorAll(".plot")];
    for (const plot of plots) {
      const go = ({ clientX }) => {
        const { left, width } = plot.getBoundingClientRect(), { first, last } = plot.dataset;
        seek(Number(first) + ((clientX - left) / width) * (last - first));
      };
      plot.onpointerdown = go;
      plot.onpointermove = (event) => event.buttons && go(event);
    }
    told = -1;
  });
  buttons.forEach((b) => (b.onclick = () => load(b.dataset.scene)));
  load("0");
})();
