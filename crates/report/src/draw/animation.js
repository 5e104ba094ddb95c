
(() => {
  'use strict';
  const calm = matchMedia('(prefers-reduced-motion: reduce)');
  const fixed = (value, digits) => {
    const text = Math.abs(value).toFixed(digits);
    return (value < 0 && Number(text) !== 0 ? '\u2212' : '') + text;
  };
  // Actions before and after printing by block; removed blocks are garbage collected.
  const forPaper = new WeakMap();
  const setUp = (block) => {
    const data = JSON.parse(block.querySelector('script').textContent);
    const vehicles = data.vehicles;
    const last = vehicles.length ? vehicles[0].position_m.length - 1 : 0;
    if (last < 1) return;
    const [controls, button, slider] = ['.draw-controls', 'button', 'input'].map((name) => block.querySelector(name));
    const clock = block.querySelector('.draw-time');
    const event = block.querySelector('.draw-event');
    const cells = [...block.querySelectorAll('tbody tr')].map((row) => row.querySelectorAll('td'));
    const views = [...block.querySelectorAll('.draw-view')].map((view) => ({
      width: Number(view.dataset.width),
      scale: Number(view.dataset.scale),
      middle: Number(view.dataset.lane),
      beside: Number(view.dataset.beside),
      lane: view.querySelector('.draw-lane'),
      vehicles: [...view.querySelectorAll('.draw-vehicle')],
      gaps: [...view.querySelectorAll('.draw-gap')],
      impacts: [...view.querySelectorAll('.draw-impact')],
    }));
    const dash = Number(block.dataset.dash);
    const timeOf = (sample) => Math.min(data.start_s + sample * data.step_s, data.end_s);
    let now = data.end_s;

    const show = () => {
      const sample = Math.min(Math.floor((now - data.start_s) / data.step_s + 1e-6), last - 1);
      const share = Math.min(Math.max((now - timeOf(sample)) / (timeOf(sample + 1) - timeOf(sample)), 0), 1);
      const at = (values) => values[sample] + (values[sample + 1] - values[sample]) * share;
      const fronts = vehicles.map((vehicle) => at(vehicle.position_m));
      const held = (vehicle) => vehicle.acceleration_mps2[share > 1 - 1e-6 ? sample + 1 : sample];
      const inLane = ({ in_lane_s: span }) => !span || (span[0] <= now + 1e-6 && now < span[1] - 1e-6);
      const gap = (rear) => {
        const isAhead = (vehicle, index) => index < rear && inLane(vehicle);
        const ahead = inLane(vehicles[rear]) ? vehicles.findLastIndex(isAhead) : -1;
        return ahead < 0 ? null : fronts[ahead] - vehicles[ahead].length_m - fronts[rear];
      };
      const [first, end] = data.centred;
      const camera = (fronts[first] + fronts[end] - vehicles[end].length_m) / 2;
      for (const view of views) {
        const x = (position) => view.width / 2 + (position - camera) * view.scale;
        const move = (element, to, y = element.transform.baseVal.getItem(0).matrix.f) =>
          element.setAttribute('transform', `translate(${to.toFixed(1)} ${y})`);
        const left = camera - view.width / 2 / view.scale;
        view.lane.setAttribute('stroke-dashoffset', ((((left % dash) + dash) % dash) * view.scale).toFixed(1));
        view.vehicles.forEach((vehicle, index) => {
          move(vehicle, x(fronts[index]), inLane(vehicles[index]) ? view.middle : view.beside);
          const braking = held(vehicles[index]) < -0.5;
          vehicle.querySelector('.draw-brake').setAttribute('visibility', braking ? 'visible' : 'hidden');
        });
        view.gaps.forEach((label, before) => {
          const rear = before + 1;
          move(label, x(fronts[rear] + (gap(rear) || 0) / 2));
          label.querySelector('text').textContent = gap(rear) === null ? '' : `${fixed(gap(rear), 1)} m`;
        });
        view.impacts.forEach((star, index) => {
          move(star, x(fronts[data.impacts[index].rear]));
          star.setAttribute('visibility', data.impacts[index].time_s <= now + 1e-6 ? 'visible' : 'hidden');
        });
      }
      cells.forEach(([speed, acceleration, ahead], index) => {
        speed.textContent = fixed(at(vehicles[index].speed_mps), 1);
        acceleration.textContent = fixed(held(vehicles[index]), 1);
        if (index > 0) ahead.textContent = gap(index) === null ? '\u2013' : fixed(gap(index), 2);
      });
      clock.textContent = `${now.toFixed(2)} s`;
      const hits = data.impacts.filter((impact) => impact.time_s <= now + 1e-6);
      const hit = hits[hits.length - 1];
      event.textContent = hit
        ? `\u2717 ${hit.rear} hits ${hit.front} at ${hit.time_s.toFixed(2)} s, ${hit.impact_speed_mps.toFixed(1)} m/s`
        : 'no contact';
      slider.value = String(share > 0.5 ? sample + 1 : sample);
      slider.setAttribute('aria-valuetext', `${now.toFixed(2)} s, ${event.textContent}`);
    };

    let request = 0;
    let before = null;
    let due = 0;
    const pause = () => {
      cancelAnimationFrame(request);
      request = 0;
      button.textContent = 'Play';
    };
    const frame = (clockMs) => {
      if (!block.isConnected) return;
      // The time of a frame may be before the click, so the first frame only starts the clock.
      if (before !== null) due += Math.min(Math.max(clockMs - before, 0) / 1000, 0.2);
      before = clockMs;
      // With reduced motion the picture changes every half second.
      if (!calm.matches || due >= 0.5) {
        now = Math.min(now + due, data.end_s);
        due = 0;
        show();
      }
      if (now >= data.end_s) pause();
      else request = requestAnimationFrame(frame);
    };
    const play = () => {
      if (now >= data.end_s) now = data.start_s;
      button.textContent = 'Pause';
      due = 0;
      before = null;
      show();
      request = requestAnimationFrame(frame);
    };
    button.addEventListener('click', () => (request ? pause() : play()));
    slider.addEventListener('input', () => {
      if (request) pause();
      now = timeOf(Number(slider.value));
      show();
    });
    // Printed pages show the end, which the text describes.
    let shown = now;
    forPaper.set(block, {
      before: () => {
        pause();
        shown = now;
        now = data.end_s;
        show();
      },
      after: () => {
        now = shown;
        show();
      },
    });
    controls.hidden = false;
    show();
  };
  const blocks = () => [...document.querySelectorAll('.draw-animation')];
  for (const when of ['before', 'after']) {
    addEventListener(`${when}print`, () => blocks().forEach((block) => forPaper.get(block)?.[when]()));
  }
  blocks().forEach(setUp);
  // A page dispatches this event on a block that it inserts later.
  document.addEventListener('draw-animation', (event) => setUp(event.target));
})();
