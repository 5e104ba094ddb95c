"""Pictures of the study."""

import math

from drives import REFERENCE, SHOWN, clopper_pearson, label


def draw(title, controllers, passing):
    """Returns the picture of the collisions ahead and behind, in percent of the emergencies, as SVG."""
    left, top, size = 70, 60, 480
    x = lambda value: left + size * value / 100
    y = lambda value: top + size * (1 - value / 100)
    count = controllers[REFERENCE].count
    widest = 100 * max(high - low for one in controllers.values() for side in (one.ahead, one.behind)
                       for low, high in [clopper_pearson(sum(side), one.count)]) / 2
    out = ['<svg xmlns="http://www.w3.org/2000/svg" width="860" height="610" viewBox="0 0 860 610" '
           'font-family="sans-serif" font-size="12">', '<rect width="860" height="610" fill="white"/>',
           f'<text x="{left}" y="24" font-size="16">{title}</text>',
           f'<text x="{left}" y="44" fill="#444">{count} simulated emergencies; 95 % intervals are at most '
           f'±{widest:.1f} percentage points</text>']
    for value in range(0, 101, 20):
        out.append(f'<path d="M{x(value):.1f} {top}V{top + size}M{left} {y(value):.1f}H{left + size}" stroke="#ddd"/>')
        out.append(f'<text x="{x(value):.1f}" y="{top + size + 18}" text-anchor="middle">{value} %</text>')
        out.append(f'<text x="{left - 8}" y="{y(value) + 4:.1f}" text-anchor="end">{value} %</text>')
    out.append(f'<text x="{left + size / 2}" y="{top + size + 42}" text-anchor="middle">'
               'Hit from behind (% of emergencies)</text>')
    out.append(f'<text transform="translate(18 {top + size / 2}) rotate(-90)" text-anchor="middle">'
               'Hits the vehicle ahead (% of emergencies)</text>')
    points = {name: (x(100 * sum(one.behind) / count), y(100 * sum(one.ahead) / count))
              for name, one in controllers.items() if name in SHOWN}
    taken, names, markers = list(points.values()), [], []
    angles = [math.radians(angle) for angle in range(0, 360, 30)]
    for number, name in enumerate(SHOWN, 1):
        px, py = points[name]
        places = [(px + far * math.cos(angle), py + far * math.sin(angle)) for far in (20, 28, 36, 46, 58)
                  for angle in angles]
        is_free = lambda place: (left + 12 < place[0] < left + size - 12 and top - 14 < place[1] < top + size - 12
                                 and all(math.dist(place, other) > 17 for other in taken))
        lx, ly = next(filter(is_free, places))
        taken.append((lx, ly))
        passes = passing.get(name) == "yes"
        color = "#0060a0" if passes else "#c04000"
        shape = (f'<circle cx="{px:.1f}" cy="{py:.1f}" r="4"' if passes else
                 f'<rect x="{px - 3.5:.1f}" y="{py - 3.5:.1f}" width="7" height="7"')
        markers.append(f'<line x1="{px:.1f}" y1="{py:.1f}" x2="{lx:.1f}" y2="{ly:.1f}" stroke="#444"/>')
        names.append(shape + f' fill="none" stroke="{color}" stroke-width="1.6"/>')
        names.append(f'<circle cx="{lx:.1f}" cy="{ly:.1f}" r="8" fill="white"/>')
        names.append(f'<text x="{lx:.1f}" y="{ly + 4:.1f}" text-anchor="middle" fill="{color}">{number}</text>')
        text = label(name).replace("`", "")
        names.append(f'<text x="{left + size + 24}" y="{top + 42 + 20 * number}" fill="{color}">'
                     f'{number} {text}</text>')
    for line, color, text in ((0, "#0060a0", "blue circles: pass the modelled tests"),
                              (1, "#c04000", "red squares: fail")):
        out.append(f'<text x="{left + size + 24}" y="{top + 10 + 16 * line}" fill="{color}">{text}</text>')
    return "\n".join([*out, *markers, *names, "</svg>\n"])
