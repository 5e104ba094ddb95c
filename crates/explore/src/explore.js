(() => {
  'use strict';
  const byId = (id) => document.getElementById(id);
  const start = JSON.parse(byId('start').textContent);
  const SVG = 'http://www.w3.org/2000/svg';

  const element = (name, attributes = {}, ...children) => {
    const created = name.startsWith('svg:')
      ? document.createElementNS(SVG, name.slice(4))
      : document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) {
      if (value === true) created.setAttribute(key, '');
      else if (value !== false && value !== null && value !== undefined) created.setAttribute(key, value);
    }
    created.append(...children);
    return created;
  };
  const number = (value, digits) => String(Number(value.toFixed(digits)));

  // Sends a request to the server; throws its message if the server refuses the request.
  const ask = async (path, body) => {
    let response;
    try {
      response = await fetch(`api/${path}`, {
        method: 'POST',
        headers: { 'Content-Type': 'application/json' },
        body: JSON.stringify(body),
      });
    } catch {
      throw new Error('crumple explore does not respond: it may have stopped');
    }
    const answer = await response.json();
    if (!response.ok) throw new Error(answer.error.message);
    return answer;
  };

  // Runs an action one at a time, and once more after calls during its run. Meanwhile an element is marked as busy.
  const latest = (id, action) => {
    let busy = false;
    let pending = false;
    return async () => {
      pending = true;
      if (busy) return;
      busy = true;
      byId(id).setAttribute('aria-busy', 'true');
      while (pending) {
        pending = false;
        await action();
      }
      busy = false;
      byId(id).removeAttribute('aria-busy');
    };
  };

  const showError = (error) => {
    byId('error').textContent = error ? error.message : '';
    byId('error').hidden = !error;
  };

  // A slider and a field for the same number.
  const slider = (into, { label, min, max, step, value, name }, changed) => {
    const id = `slide-${name}`;
    const range = element('input', { type: 'range', id, min, max, step });
    const exact = element('input', {
      type: 'number',
      min,
      step: 'any',
      'aria-label': `${label}, exactly`,
      id: `${id}-exact`,
    });
    const digits = step < 0.1 ? 2 : 1;
    range.max = Math.max(max, Math.ceil(value));
    range.value = value;
    exact.value = number(value, 3);
    range.setAttribute('aria-valuetext', number(value, digits));
    range.addEventListener('input', () => {
      exact.value = number(Number(range.value), digits);
      range.setAttribute('aria-valuetext', exact.value);
      changed(Number(range.value));
    });
    exact.addEventListener('input', () => {
      if (exact.value === '' || !Number.isFinite(Number(exact.value))) return;
      range.value = exact.value;
      range.setAttribute('aria-valuetext', exact.value);
      changed(Number(exact.value));
    });
    into.append(element('div', { class: 'slide' }, element('label', { for: id }, label), range, exact));
  };

  // Drawing area for the leader's acceleration, with a value for each time cell.
  const pad = (into, changed) => {
    const [width, height, top, bottom] = [340, 150, 12, 132];
    const [under, script, cursor] = ['under', 'script', 'cursor'].map((kind) =>
      element(`svg:${kind === 'cursor' ? 'rect' : 'path'}`, { class: kind }),
    );
    const zero = element('svg:path', { class: 'zero' });
    const words = [0, 1, 2, 3].map(() => element('svg:text', {}));
    const drawing = element(
      'svg:svg',
      {
        class: 'pad',
        id: 'pad',
        viewBox: `0 0 ${width} ${height}`,
        tabindex: 0,
        role: 'slider',
        'aria-describedby': 'lead-help',
      },
      under,
      zero,
      script,
      cursor,
      ...words,
    );
    into.replaceChildren(drawing);
    let values = [];
    let limits = { low: -1, high: 1, cell_s: 1 };
    let at = 0;
    const x = (cell) => (cell / values.length) * width;
    const y = (value) => top + ((limits.high - value) / (limits.high - limits.low)) * (bottom - top);
    const paint = () => {
      let line = '';
      values.forEach((value, cell) => {
        line += `${cell ? 'L' : 'M'}${x(cell).toFixed(1)} ${y(value).toFixed(1)}H${x(cell + 1).toFixed(1)}`;
      });
      script.setAttribute('d', line);
      under.setAttribute('d', line ? `${line}V${y(0).toFixed(1)}H0Z` : '');
      zero.setAttribute('d', `M0 ${y(0).toFixed(1)}H${width}`);
      const places = [
        [4, top - 1 + 8, `${number(limits.high, 1)} m/s²`],
        [4, bottom - 2, `\u2212${number(-limits.low, 1)} m/s²`],
        [4, height - 4, '0 s'],
        [width - 38, height - 4, `${number(values.length * limits.cell_s, 1)} s`],
      ];
      words.forEach((word, index) => {
        const [left, base, text] = places[index];
        word.setAttribute('x', left);
        word.setAttribute('y', base);
        word.textContent = text;
      });
      Object.entries({ x: x(at), y: top, width: width / Math.max(values.length, 1), height: bottom - top }).forEach(
        ([key, to]) => cursor.setAttribute(key, to.toFixed(1)),
      );
      const now = values[at] ?? 0;
      Object.entries({
        'aria-label': 'Acceleration of vehicle 0 over time',
        'aria-valuemin': number(limits.low, 1),
        'aria-valuemax': number(limits.high, 1),
        'aria-valuenow': number(now, 1),
        'aria-valuetext': `at ${number(at * limits.cell_s, 2)} s: ${number(now, 1)} m/s²`,
      }).forEach(([key, to]) => drawing.setAttribute(key, to));
    };
    const put = (cell, value) => {
      values[cell] = Math.min(Math.max(Math.round(value * 10) / 10, limits.low), limits.high);
    };
    const publish = () => {
      paint();
      changed(values, limits.cell_s);
    };
    let last = null;
    const draw = (event) => {
      const box = drawing.getBoundingClientRect();
      const cell = Math.min(
        Math.max(Math.floor(((event.clientX - box.left) / box.width) * values.length), 0),
        values.length - 1,
      );
      const share = (((event.clientY - box.top) / box.height) * height - top) / (bottom - top);
      const value = limits.high - share * (limits.high - limits.low);
      // Fills the cells between two events of a fast pointer.
      const from = last ?? { cell, value };
      const steps = Math.max(Math.abs(cell - from.cell), 1);
      for (let step = 0; step <= steps; step += 1) {
        put(
          Math.round(from.cell + ((cell - from.cell) * step) / steps),
          from.value + ((value - from.value) * step) / steps,
        );
      }
      last = { cell, value };
      at = cell;
      publish();
    };
    drawing.addEventListener('pointerdown', (event) => {
      if (!values.length) return;
      drawing.setPointerCapture(event.pointerId);
      last = null;
      draw(event);
      event.preventDefault();
      drawing.focus({ focusVisible: false });
    });
    drawing.addEventListener('pointermove', (event) => {
      if (drawing.hasPointerCapture(event.pointerId)) draw(event);
    });
    drawing.addEventListener('keydown', (event) => {
      const by = {
        ArrowLeft: [-1, 0],
        ArrowRight: [1, 0],
        ArrowUp: [0, 0.5],
        ArrowDown: [0, -0.5],
        PageUp: [0, 2],
        PageDown: [0, -2],
      }[event.key];
      if (!by || !values.length) return;
      event.preventDefault();
      at = Math.min(Math.max(at + by[0], 0), values.length - 1);
      if (by[1]) {
        put(at, values[at] + by[1]);
        publish();
      } else paint();
    });
    return {
      show: (lead, duration_s) => {
        limits = { low: -lead.max_brake_mps2, high: Math.max(lead.max_accel_mps2, 0.5), cell_s: lead.cell_s };
        values = lead.accel_mps2
          ? [...lead.accel_mps2]
          : new Array(Math.max(1, Math.ceil(duration_s / lead.cell_s - 1e-9))).fill(0);
        at = Math.min(at, values.length - 1);
        paint();
      },
      limit: (low, high) => {
        limits = { ...limits, low, high: Math.max(high, 0.5) };
        values = values.map((value) => Math.min(Math.max(value, low), high));
        paint();
        return values;
      },
    };
  };

  // Converts cells to a script of a scenario file, which has the times at which the value changes.
  const pieces = (values, cell_s) => {
    const from_s = [];
    const accel_mps2 = [];
    values.forEach((value, cell) => {
      if (cell > 0 && value === accel_mps2[accel_mps2.length - 1]) return;
      from_s.push(Math.round(cell * cell_s * 1e9) / 1e9);
      accel_mps2.push(value);
    });
    return { from_s, accel_mps2 };
  };

  const chosenControllers = () => [...byId('chosen').querySelectorAll('input:checked')].map((box) => box.value);

  // Calls an action when the selected controllers change. At least one, and at most as many as fit, are selected.
  const onControllersChanged = (action) => {
    byId('chosen').addEventListener('change', (event) => {
      const count = chosenControllers().length;
      if (count < 1 || count > start.most_controllers) event.target.checked = !event.target.checked;
      else action();
    });
  };

  const showLines = (id, lines) =>
    byId(id).replaceChildren(...lines.map((line) => element('p', { class: 'told' }, line)));

  const scenarioPage = () => {
    // Number of vehicles with sliders, so that the list stays clear.
    const MAX_SLIDERS = 8;
    const narrow = matchMedia('(max-width:760px)');
    let opened = null;
    let edits = { vehicles: new Map() };
    const query = new URLSearchParams(location.search);

    const edited = () => ({
      name: byId('name').value,
      friction: edits.friction,
      lead: edits.lead,
      vehicles: [...edits.vehicles].map(([vehicle, changes]) => ({ vehicle, ...changes })),
    });
    const request = () => ({ scenario: opened.scenario, edits: edited() });
    const testDriver = () => opened.test_driver ?? null;

    let announcement = 0;
    const show = (drawn) => {
      byId('verdicts').className = 'verdicts';
      byId('verdicts').replaceChildren(
        ...drawn.runs.map((run) =>
          element(
            'div',
            {
              class: `verdict ${run.verdict === 'safe' ? 'good' : 'bad'}`,
              'data-verdict': run.verdict,
              'data-collision': run.collision_time_s,
            },
            element('b', {}, run.controller),
            run.summary,
            ...run.notes.map((note) => element('span', { class: 'note' }, note)),
          ),
        ),
      );
      byId('figures').innerHTML = drawn.figures;
      // Screen readers announce the result only when the changes stop.
      clearTimeout(announcement);
      announcement = setTimeout(() => {
        byId('said').textContent = drawn.runs.map((run) => `${run.controller}: ${run.summary}`).join('. ');
      }, 600);
    };

    const run = latest('verdicts', async () => {
      const began = performance.now();
      try {
        show(
          await ask('run', {
            ...request(),
            controllers: chosenControllers(),
            estimator: byId('estimator').value,
            narrow: narrow.matches,
            test_driver: testDriver(),
          }),
        );
        showError(null);
      } catch (error) {
        showError(error);
      }
      if (performance.getEntriesByName('drag').length > 500) performance.clearMeasures('drag');
      performance.measure('drag', { start: began, end: performance.now() });
    });
    const changed = () => {
      byId('avoided').replaceChildren();
      byId('saved').textContent = '';
      run();
    };
    const change = (vehicle, changes) => {
      edits.vehicles.set(vehicle, { ...edits.vehicles.get(vehicle), ...changes });
      changed();
    };

    const lead = pad(byId('lead'), (values, cell_s) => {
      edits.lead = pieces(values, cell_s);
      changed();
    });

    const vehicleSliders = (vehicle, index) => {
      const box = element(
        'fieldset',
        {},
        element('legend', {}, `${index} ${vehicle.name}`),
        element('p', { class: 'hint' }, `driven by ${vehicle.driver}`),
      );
      if (vehicle.gap_m !== null && vehicle.gap_m > 0) {
        slider(
          box,
          { label: 'Gap ahead (m)', min: 0.5, max: 100, step: 0.1, value: vehicle.gap_m, name: `gap-${index}` },
          (gap_m) => change(index, { gap_m }),
        );
      }
      slider(
        box,
        { label: 'Speed (m/s)', min: 0, max: 50, step: 0.1, value: vehicle.speed_mps, name: `speed-${index}` },
        (speed_mps) => change(index, { speed_mps }),
      );
      const classes = element(
        'select',
        { id: `class-${index}` },
        ...start.classes.map(({ name }) => element('option', { value: name, selected: name === vehicle.class }, name)),
      );
      classes.addEventListener('change', () => {
        if (index === 0) {
          const limits = start.classes.find(({ name }) => name === classes.value);
          const limited = lead.limit(-limits.max_brake_mps2, limits.max_accel_mps2);
          if (edits.lead) edits.lead = pieces(limited, opened.sliders.lead.cell_s);
        }
        change(index, { class: classes.value });
      });
      box.append(element('label', {}, 'Class ', classes));
      return box;
    };

    const begin = () => {
      const { sliders, scenario } = opened;
      edits = { vehicles: new Map() };
      byId('name').value = sliders.name;
      byId('about').textContent = [scenario.about, opened.note].filter(Boolean).join(' ');
      byId('about').hidden = !byId('about').textContent;
      byId('road').replaceChildren();
      slider(
        byId('road'),
        { label: 'Friction (1 is dry)', min: 0.05, max: 1, step: 0.01, value: sliders.friction, name: 'friction' },
        (friction) => {
          edits.friction = friction;
          changed();
        },
      );
      byId('vehicles').replaceChildren(...sliders.vehicles.slice(0, MAX_SLIDERS).map(vehicleSliders));
      const more = sliders.vehicles.length - MAX_SLIDERS;
      if (more > 0) byId('vehicles').append(element('p', { class: 'hint' }, `${more} more vehicles have no sliders.`));
      lead.show(sliders.lead, sliders.duration_s);
      changed();
    };
    const open = async (what, call = 'open') => {
      try {
        opened = await ask(call, what);
        if (opened.controller) {
          byId('chosen')
            .querySelectorAll('input')
            .forEach((box) => {
              box.checked = box.value === opened.controller;
            });
        }
        if (opened.estimator) byId('estimator').value = opened.estimator;
        begin();
      } catch (error) {
        showError(error);
      }
    };

    byId('scenario').addEventListener('change', () => open({ scenario: Number(byId('scenario').value) }));
    byId('reset').addEventListener('click', begin);
    byId('lead-back').addEventListener('click', () => {
      delete edits.lead;
      lead.show(opened.sliders.lead, opened.sliders.duration_s);
      changed();
    });
    byId('estimator').addEventListener('change', run);
    byId('name').addEventListener('input', () => {
      byId('saved').textContent = '';
    });
    narrow.addEventListener('change', run);
    onControllersChanged(run);
    byId('avoid').addEventListener('click', async () => {
      const [button, place] = [byId('avoid'), byId('avoided')];
      button.disabled = true;
      place.replaceChildren(element('p', {}, 'Searching for an escape …'));
      try {
        const { statements, escape_figure: escape, verdict } = await ask('avoid', request());
        place.replaceChildren(...statements.map((line) => element('p', {}, line)));
        place.dataset.verdict = verdict;
        place.insertAdjacentHTML('beforeend', escape);
      } catch (error) {
        place.replaceChildren(element('p', { class: 'bad' }, error.message));
      }
      button.disabled = false;
    });
    const download = async () => {
      const status = byId('saved');
      try {
        const saved = await ask('save', {
          edited: request(),
          controller: chosenControllers()[0],
          estimator: byId('estimator').value,
          test_driver: testDriver(),
        });
        const address = URL.createObjectURL(new Blob([saved.toml], { type: 'application/toml' }));
        element('a', { href: address, download: saved.file_name }).click();
        setTimeout(() => URL.revokeObjectURL(address), 10_000);
        status.replaceChildren('Repeat with ', element('code', {}, saved.command));
      } catch (error) {
        status.replaceChildren(element('span', { class: 'bad' }, error.message));
      }
    };
    byId('download').addEventListener('click', download);
    byId('controls').addEventListener('submit', (event) => event.preventDefault());

    const numbers = (keys) => {
      const given = keys.filter((key) => /^\d+$/.test(query.get(key) ?? ''));
      return Object.fromEntries(given.map((key) => [key, Number(query.get(key))]));
    };
    if (query.has('suite')) {
      const point = numbers(['failure', 'passes_at', 'fails_at']);
      const test = { ...numbers(['suite', 'test', 'controller']), estimator: query.get('estimator') ?? undefined };
      open({ ...test, point: Object.keys(point).length ? point : 'first' }, 'open-test');
      return;
    }
    const what = numbers(['scenario', 'campaign', 'counterexample', 'evaluation']);
    open(Object.keys(what).length ? what : { scenario: 0 });
  };

  const campaignsPage = () => {
    if (!byId('filters')) return;
    const narrow = matchMedia('(max-width:760px)');
    const chosen = (id) => byId(id).value;
    // Sets the options of a selection, and keeps its selected value if possible.
    const setOptions = (id, names, first = []) => {
      const select = byId(id);
      const before = select.value;
      const options = [...first, ...names.map((name) => [name, name])];
      if ([...select.options].map((option) => option.value).join('\n') === options.map(([value]) => value).join('\n'))
        return;
      select.replaceChildren(...options.map(([value, words]) => element('option', { value }, words)));
      if (options.some(([value]) => value === before)) select.value = before;
    };
    // Replaces only changed markup, so that the user's focus and position in the rest stay.
    const shown = new Map();
    const put = (id, markup) => {
      if (shown.get(id) === markup) return;
      shown.set(id, markup);
      byId(id).innerHTML = markup;
    };
    let later = 0;
    const look = latest('words', async () => {
      clearTimeout(later);
      const named = (id) => chosen(id) || null;
      try {
        const state = await ask('campaign', {
          campaign: Number(chosen('campaign')),
          against: chosen('against') === '' ? null : Number(chosen('against')),
          x_parameter: named('across'),
          y_parameter: named('up'),
          method: named('method'),
          kind: named('kind'),
          narrow: narrow.matches,
        });
        showError(null);
        setOptions('across', state.coordinates);
        setOptions('up', state.coordinates);
        byId('across').value = state.x_parameter;
        byId('up').value = state.y_parameter;
        setOptions('method', state.methods, [['', 'every method']]);
        setOptions('kind', state.kinds, [['', 'every kind']]);
        showLines('words', state.summaries);
        ['best', 'maps', 'distinct', 'failures'].forEach((id) => put(id, state[id]));
      } catch (error) {
        showError(error);
        later = setTimeout(look, 3000);
      }
    });
    byId('filters').addEventListener('submit', (event) => event.preventDefault());
    byId('filters').addEventListener('change', (event) => {
      // Another campaign has other parameters and kinds of failures.
      if (event.target.id === 'campaign')
        ['across', 'up', 'method', 'kind'].forEach((id) => byId(id).replaceChildren());
      look();
    });
    narrow.addEventListener('change', look);
    look();
  };

  const recordingsPage = () => {
    if (!byId('recording')) return;
    const narrow = matchMedia('(max-width:760px)');
    let selected = null;
    const request = (drive) => ({
      recording: Number(byId('recording').value),
      drive,
      controllers: chosenControllers(),
      narrow: narrow.matches,
    });

    const showDrive = latest('figures', async () => {
      if (!selected) return;
      const { drive, window_s } = selected;
      try {
        const { figure, brakings } = await ask('replay', { ...request(drive), window_s, figure: true });
        byId('figures').innerHTML = figure;
        byId('brakings').innerHTML = brakings;
        byId('drive-name').textContent = `Drive ${drive + 1}`;
        byId('drive-name').hidden = false;
        byId('whole').hidden = !window_s;
        showError(null);
      } catch (error) {
        showError(error);
      }
    });
    const select = (drive, window_s = null) => {
      selected = { drive, window_s };
      return showDrive();
    };

    // Fills the column of commanded braking, drive by drive.
    const fill = async (count) => {
      const cells = byId('drives').querySelectorAll('.commanded');
      for (let drive = 0; drive < count; drive += 1) {
        const asked = request(drive);
        let counts;
        try {
          ({ counts } = await ask('replay', asked));
        } catch (error) {
          counts = [error.message];
        }
        if (JSON.stringify(asked) !== JSON.stringify(request(drive)) || !cells[drive].isConnected) return;
        cells[drive].replaceChildren(...counts.map((line) => element('div', {}, line)));
      }
    };
    const open = latest('drives', async () => {
      try {
        const { summaries, drives, count } = await ask('recording', { recording: Number(byId('recording').value) });
        showLines('words', summaries);
        byId('drives').innerHTML = drives;
        showError(null);
        if (count) select(selected ? Math.min(selected.drive, count - 1) : 0, selected?.window_s);
        await fill(count);
      } catch (error) {
        showError(error);
      }
    });

    byId('recording').addEventListener('change', () => {
      selected = null;
      open();
    });
    onControllersChanged(open);
    narrow.addEventListener('change', showDrive);
    byId('whole').addEventListener('click', () => select(selected.drive));
    byId('controls').addEventListener('submit', (event) => event.preventDefault());
    byId('drives').addEventListener('click', (event) => {
      const link = event.target.closest('[data-drive]');
      if (!link) return;
      event.preventDefault();
      select(Number(link.dataset.drive)).then(() => byId('drive-name').scrollIntoView());
    });
    byId('brakings').addEventListener('click', (event) => {
      const link = event.target.closest('[data-from]');
      if (!link) return;
      event.preventDefault();
      const window_s = [Number(link.dataset.from), Number(link.dataset.until)];
      select(selected.drive, window_s).then(() => byId('drive-name').scrollIntoView());
    });
    open();
  };

  const suitesPage = () => {
    if (!byId('suite')) return;
    const show = latest('tests', async () => {
      const all = chosenControllers();
      const estimator = byId('estimator').value;
      // Shows the results as they arrive; the server keeps them.
      for (let count = 1; count <= all.length; count += 1) {
        byId('said').textContent = `Running the suite with ${all[count - 1]} …`;
        try {
          const asked = { suite: Number(byId('suite').value), controllers: all.slice(0, count), estimator };
          const { summaries, tests } = await ask('suite', asked);
          showLines('words', summaries);
          byId('tests').innerHTML = tests;
          showError(null);
        } catch (error) {
          showError(error);
        }
      }
      byId('said').textContent = '';
    });
    byId('suite').addEventListener('change', show);
    byId('estimator').addEventListener('change', show);
    onControllersChanged(show);
    byId('controls').addEventListener('submit', (event) => event.preventDefault());
    show();
  };

  ({ scenario: scenarioPage, campaigns: campaignsPage, recordings: recordingsPage, suites: suitesPage })[
    document.body.dataset.page
  ]();
})();
