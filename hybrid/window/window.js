// The window as elements of a page: draws what arrives, and sends what happens (see hybrid/window/page.py).
function hybridWindow(root, send, setTitle) {
  root.classList.add('hybrid-window');
  root.innerHTML = `
    <div><div class="canvas" tabindex="0" data-lm-suppress-shortcuts="true">
      <canvas></canvas><pre class="hud"></pre><pre class="overlay"></pre></div>
      <div class="line"><progress hidden></progress><span></span></div></div>
    <div class="panel" hidden></div>`;
  const [box, canvas, hud, overlay, progress, line, panel] =
    ['.canvas', 'canvas', '.hud', '.overlay', 'progress', 'span', '.panel'].map((name) => root.querySelector(name));
  const context = canvas.getContext('2d', { alpha: false });
  const state = {}, rows = {};
  let picture, size, disc, lost = '', sized = false, mover, drawing = Promise.resolve();

  const tell = (type, more, timestamp) => send({ type, timestamp: timestamp ?? performance.now(), ...more });

  // The frame in its own proportions, as large as it fits, and the ring around its disc.
  function place() {
    const scale = Math.min(canvas.width / size[0], canvas.height / size[1]);
    const [width, height] = size.map((side) => scale * side);
    return [(canvas.width - width) / 2, (canvas.height - height) / 2, width, height];
  }
  function draw() {
    if (!picture) return;
    const [x, y, width, height] = place();
    if (width !== canvas.width || height !== canvas.height) context.fillRect(0, 0, canvas.width, canvas.height);
    context.drawImage(picture, x, y, width, height);
    if (!state.ring) return;
    context.strokeStyle = '#ffffff6e';
    context.lineWidth = devicePixelRatio;
    context.beginPath();
    context.arc(x + disc.x * width, y + disc.y * height, disc.radius * height, 0, 7);
    context.stroke();
  }

  // Other browsers, and pages that were not sent over a safe connection, have no decoder. A blob takes a millisecond
  // of the browser's time.
  async function decode(bytes, type) {
    if (!window.ImageDecoder) return createImageBitmap(new Blob([bytes], { type }));
    const decoder = new ImageDecoder({ type, data: bytes });
    const { image } = await decoder.decode();
    decoder.close();
    return image;
  }
  async function show(frame, bytes) {
    const decoded = await decode(bytes, frame.type);
    picture?.close();
    [picture, disc] = [decoded, frame];
    size = [decoded.displayWidth ?? decoded.width, decoded.displayHeight ?? decoded.height];
    draw();
    box.dataset.frame = frame.number;
    // Right before the page is painted; a page that is hidden is not, and gets no further frames.
    requestAnimationFrame(() => tell('shown', { frame: frame.number }));
  }

  // Text that stays as it is would be laid out again, too.
  const put = (element, text) => { if (element.textContent !== text) element.textContent = text; };
  function write() {
    put(hud, (state.hud ?? []).join('\n'));
    put(overlay, lost || (state.overlay ?? []).join('\n'));
    progress.hidden = !state.progress;
    let text = state.line ?? '';
    if (state.progress) {
      const [activity, done, total] = state.progress;
      if (total) Object.assign(progress, { value: done, max: total });
      else progress.removeAttribute('value');
      text = total ? `${activity} ${done} / ${total}` : activity;
    }
    put(line, text);
    panel.hidden = !state.panel;
  }

  function build(controls) {
    panel.replaceChildren();
    for (const { name, kind, low, high, entries } of controls) {
      const label = document.createElement('label');
      const input = document.createElement(kind === 'list' ? 'select' : 'input');
      if (kind === 'list') input.append(...entries.map((entry, number) => new Option(entry, number)));
      else if (kind === 'switch') input.type = 'checkbox';
      else Object.assign(input, { type: 'range', min: low, max: high });
      input.name = name;
      input.oninput = () => tell('control', { name, value: kind === 'switch' ? Number(input.checked) : Number(input.value) });
      // Keys belong to the frame.
      input.onchange = () => box.focus();
      panel.append(label, input);
      rows[name] = { label, input };
    }
  }

  function fill(values) {
    for (const [name, [value, text, enabled]] of Object.entries(values)) {
      const { label, input } = rows[name];
      label.textContent = text;
      if (input.type === 'checkbox') input.checked = value;
      // What a hand moves right now is not moved back.
      else if (!(input.type === 'range' && input.matches(':active'))) input.value = value;
      input.disabled = !enabled;
    }
  }

  // For a bench: a mouse that moves along points of the frame, one after the other. As for one of flesh and blood, the
  // browser tells of it once before each painting.
  function follow(path) {
    cancelAnimationFrame(mover);
    const began = performance.now();
    const move = () => {
      mover = requestAnimationFrame(move);
      const step = Math.floor((performance.now() - began) / path.ms) % path.points.length;
      const [x, y, width, height] = place(), edge = canvas.getBoundingClientRect(), ratio = canvas.width / edge.width;
      canvas.dispatchEvent(new PointerEvent('pointermove', {
        clientX: edge.x + (x + path.points[step][0] * width) / ratio,
        clientY: edge.y + (y + path.points[step][1] * height) / ratio,
      }));
    };
    if (path) move();
  }

  const point = (event) => {
    const edge = canvas.getBoundingClientRect();
    return { x: event.clientX - edge.x, y: event.clientY - edge.y };
  };
  canvas.onpointermove = (event) => tell('pointer_move', point(event), event.timeStamp);
  canvas.onpointerdown = (event) => {
    box.focus();
    if (event.isTrusted) canvas.setPointerCapture(event.pointerId);
    tell('pointer_down', { ...point(event), button: event.button === 0 ? 1 : 0 });
  };
  canvas.onpointerup = (event) => tell('pointer_up', { ...point(event), button: event.button === 0 ? 1 : 0 });
  canvas.onpointercancel = () => tell('blur');
  const full = (key) => {
    if (key === 'f' && !document.fullscreenElement) box.requestFullscreen();
    else if (document.fullscreenElement) document.exitFullscreen();
  };
  box.onkeydown = (event) => {
    // Those of the browser and of a notebook stay theirs.
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    event.stopPropagation();
    event.preventDefault();
    if (['f', 'Escape'].includes(event.key)) { if (!event.repeat) full(event.key); }
    else tell('key_down', { key: event.key, repeat: event.repeat });
  };
  box.onkeyup = (event) => { event.stopPropagation(); tell('key_up', { key: event.key }); };
  box.onblur = () => tell('blur');

  function resize() {
    const { clientWidth: width, clientHeight: height } = box;
    if (!sized || !width || !height) return;
    const [pwidth, pheight] = [width, height].map((side) => Math.round(side * devicePixelRatio));
    // Setting the size of a canvas clears it.
    if (canvas.width !== pwidth || canvas.height !== pheight) Object.assign(canvas, { width: pwidth, height: pheight });
    draw();
    tell('resize', { width, height, pwidth, pheight });
  }
  new ResizeObserver(resize).observe(box);

  return {
    // Frames that arrive one after the other are drawn one after the other.
    receive(message, bytes) {
      const { frame, ...news } = message;
      Object.assign(state, news);
      if (news.title) setTitle(news.title);
      if (news.size && !sized) {
        sized = true;
        [box.style.width, box.style.height] = news.size.map((side) => `${side / devicePixelRatio}px`);
        box.focus();
        resize();
      }
      if (news.controls) build(news.controls);
      if (news.values) fill(news.values);
      if ('path' in news) drawing.then(() => follow(news.path));
      if ('ring' in news) draw();
      write();
      if (frame) drawing = drawing.then(() => show(frame, bytes));
    },
    connect() { lost = ''; write(); if (sized) resize(); },
    say(text) { lost = text; write(); },
  };
}
