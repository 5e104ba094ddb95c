"""The page of the study: its first part, tables, pictures and tables of comma-separated values."""

import itertools
import re
import sys
import textwrap

from drives import FOLLOWERS, change, interval, level, quantile, weights
from findings import (SPACE, all_answers, assisted_systems, combinations, comparisons, compare, conforming_level,
                      number, relative_change, relative_curve, repeated, systems_answers, threshold_s,
                      within_the_tests)
from study import (ADDED, ASSISTED, BRAKE, CONFORMING, CONFORMING_SPACES, HUMAN, NONE, QUESTIONS,
                   SPACES_WITHIN_THE_TESTS, SYSTEMS)

TITLE = "# Emergency braking and rear-end collisions"
MAIN = ("hold", "kalman")
Z = quantile(0.05)
SHOWN_THRESHOLDS_S = (1.4, 2.0, 3.0)
# A first part of this length fits on one printed page (A4, 10.5 points, margins of 2 cm).
MAX_WORDS, MAX_WORDS_OF_FIRST_PART, MAX_COLUMNS = 2500, 610, 6
# Share of lorries among the vehicles behind in the tables, in percent: that of vehicle-miles in the United States.
LORRY_PERCENT = 10
LABELS = {NONE: "no brake", HUMAN: "human"}
# Changes of striking and of being struck in the field, in percent.
FIELD = next([round(100 * question[name]) for name in ("striking", "struck")]
             for question in QUESTIONS["questions"] if question["kind"] == "field")
# Largest half of an interval in the table of systems, in percent, which the page states.
MAX_ERROR_PERCENT = 3
SHOWN = [NONE, "emergency-brake", BRAKE,
         *(name for name in SYSTEMS if name.startswith("car:")), "autoware-aeb", "openpilot", "acc-aeb", "idm",
         *ADDED, HUMAN, ASSISTED, CONFORMING]


def label(name):
    """Returns the name of a system in plain words."""
    settings = dict(part.split("=") for part in name.split(",")[1:])
    if name in LABELS:
        return LABELS[name]
    if name.startswith("human,"):
        return f"human + brake {settings['aeb_ttc_s']} s"
    if name.startswith("emergency-brake"):
        text = f"brake {settings.get('ttc_s', '1.4')} s"
        return text + (f", {settings['brake_mps2']} m/s²" if "brake_mps2" in settings else "")
    return f"`{name}`"


def cell(bounds, is_signed=False, digits=1):
    mean, low, high = (number(value, is_signed, digits) for value in bounds)
    return f"{mean} ({low}…{high})"


def table(columns, rows):
    if len(columns) > MAX_COLUMNS:
        sys.exit(f"error: a table has {len(columns)} columns")
    lines = ["| " + " | ".join(columns) + " |", "|---" * len(columns) + "|"]
    return "\n".join(lines + ["| " + " | ".join(map(str, row)) + " |" for row in rows])


def systems_table(results, passing):
    of, rows = weights(FOLLOWERS, LORRY_PERCENT), []
    for name in SHOWN:
        means = [level(results[after, "kalman"][SPACE, name], measure).mean(of)
                 for after, measure in (("hold", "ahead"), ("hold", "behind"), ("coast", "behind"))]
        if any(Z * error > MAX_ERROR_PERCENT for _, error in means):
            sys.exit(f"error: the interval of {name} is wider than the page states")
        rows.append((label(name), passing[name], *(number(mean, digits=0) for mean, _ in means)))
    return table(["system", "passes S7", "hits the vehicle ahead, %", "hit from behind (hold), %",
                  "hit from behind (coast), %"], rows)


PAIRS = [(HUMAN, ASSISTED), (HUMAN, CONFORMING), (NONE, BRAKE)]


def changed(part, of, pair, measure):
    before, after = pair
    return cell(interval(change(part[SPACE, after], part[SPACE, before], measure).mean(of), Z), True)


def lorries_table(results):
    part = results[MAIN]
    rows = [(f"{percent} %", *(changed(part, weights(FOLLOWERS, percent), pair, measure)
                               for pair, measure in ((PAIRS[1], "behind"), (PAIRS[1], "harm"), (PAIRS[2], "behind"),
                                                     (PAIRS[2], "harm"))))
            for percent in (0, LORRY_PERCENT, 50)]
    return table(["lorries behind", "human + brake 2 s: hit from behind", "human + brake 2 s: serious injuries",
                  "brake 2 s: hit from behind", "brake 2 s: serious injuries"], rows)


def followers_table(results):
    rows = []
    for follower in FOLLOWERS:
        of, pair = weights([follower], LORRY_PERCENT), PAIRS[1]
        rows.append((f"`{follower}`", *(changed(results[after, "kalman"], of, pair, measure)
                                        for measure in ("behind", "harm") for after in ("hold", "coast"))))
    return table(["type of follower", "hit from behind (hold)", "hit from behind (coast)", "serious injuries (hold)",
                  "serious injuries (coast)"], rows)


def conforming_table(results):
    part, rows = results[MAIN], []
    for percent in (0, 25, 50, 75, 100):
        means = [conforming_level(part, percent / 100, measure, weights(["human"], lorries))
                 for measure, lorries in (("ahead", 0), ("behind", 0), ("any", 0), ("any", 50))]
        rows.append((f"{percent} %", *(cell(interval(mean, Z)) for mean in means)))
    return table(["cars with the brake", "hits the vehicle ahead, %", "hit from behind, %", "either, %",
                  "either, half of the followers lorries, %"], rows)


def change_in_field(part, name, measure, of):
    return interval(relative_change(part, name, measure, of), Z)


def field_table(results, followers):
    """Returns the changes of striking and of being struck, with vehicles that hold their brakes or coast."""
    of, rows = weights(followers, LORRY_PERCENT), []
    hold, coast = results["hold", "kalman"], results["coast", "kalman"]
    for name in assisted_systems():
        if threshold_s(name) in SHOWN_THRESHOLDS_S:
            bounds = [change_in_field(part, name, measure, of)
                      for part, measure in ((hold, "ahead"), (hold, "behind"), (coast, "behind"))]
            rows.append((f"{threshold_s(name):g} s", *(cell(one, True, 0) for one in bounds)))
    kind = "human behind" if len(followers) == 1 else "four types behind"
    return table([f"{kind}: brake from", "striking, %", "struck (hold), %", "struck (coast), %"], rows)


def field_csv(results):
    """Returns the changes of striking and of being struck by threshold, types of followers and share of lorries."""
    lines = ["after_collision,estimator,types_of_followers,lorry_percent,brake_from_s,striking,striking_lower,"
             "striking_upper,struck,struck_lower,struck_upper"]
    for (after_collision, estimator), part in results.items():
        for followers, lorries in itertools.product((["human"], FOLLOWERS[:3], FOLLOWERS), (0, LORRY_PERCENT, 50)):
            of = weights(followers, lorries)
            for name in assisted_systems()[1:]:
                values = [value for measure in ("ahead", "behind")
                          for value in change_in_field(part, name, measure, of)]
                lines.append(",".join([after_collision, estimator, str(len(followers)), str(lorries),
                                       f"{threshold_s(name):g}", *(number(value, digits=2) for value in values)]))
    return "\n".join(lines).replace("−", "-") + "\n"


LEFT, TOP, WIDTH, HEIGHT = 70, 40, 480, 360
STRIKING, STRUCK, STRUCK_COAST = "#0060a0", "#c04000", "#d09000"


def x(value_s):
    return LEFT + WIDTH * value_s / 3


def y(percent):
    return TOP + HEIGHT * (60 - percent) / 160


def axes():
    """Returns the lines and the labels of both axes."""
    out = [f'<text x="{LEFT}" y="24" font-size="16">Change of collisions by a brake in the car of a human driver'
           '</text>']
    for value in range(-100, 61, 20):
        out.append(f'<path d="M{LEFT} {y(value):.1f}H{LEFT + WIDTH}" stroke="{"#888" if value == 0 else "#ddd"}"/>')
        out.append(f'<text x="{LEFT - 8}" y="{y(value) + 4:.1f}" text-anchor="end">{value:+d} %</text>')
    for value in (0, 1, 2, 3):
        out.append(f'<text x="{x(value):.1f}" y="{TOP + HEIGHT + 18}" text-anchor="middle">{value} s</text>')
    return [*out, f'<text x="{LEFT + WIDTH / 2}" y="{TOP + HEIGHT + 40}" text-anchor="middle">'
            'Time to collision from which the brake fires</text>']


def curve(points, line, row, what, who):
    """Returns a curve and its entry in the legend."""
    places = " ".join(f"{x(threshold):.1f},{y(percent):.1f}" for threshold, percent in points)
    return [f'<polyline points="{places}" {line}/>', f'<path d="M{LEFT + WIDTH + 14} {row - 4}h22" {line}/>',
            f'<text x="{LEFT + WIDTH + 42}" y="{row}" font-size="11">{what},</text>',
            f'<text x="{LEFT + WIDTH + 42}" y="{row + 9}" font-size="9" fill="#444">{who}</text>']


def field_picture(results):
    """Returns the curves of striking and being struck over the threshold, as SVG."""
    out = ['<svg xmlns="http://www.w3.org/2000/svg" width="760" height="470" viewBox="0 0 760 470" '
           'font-family="sans-serif" font-size="12">', '<rect width="760" height="470" fill="white"/>', *axes()]
    kinds = [("hold", 1, STRIKING, "hits the vehicle ahead"), ("hold", 2, STRUCK, "hit from behind (hold)"),
             ("coast", 2, STRUCK_COAST, "hit from behind (coast)")]
    lines = [(("human",), "human drivers behind", ""), (FOLLOWERS, "four types behind", ' stroke-dasharray="6 4"')]
    row = TOP + 114
    for followers, who, dash in lines:
        for after_collision, place, color, what in kinds:
            points = relative_curve(results[after_collision, "kalman"], weights(followers, LORRY_PERCENT))
            line = f'fill="none" stroke="{color}" stroke-width="1.8"{dash}'
            out += curve([(point[0], point[place]) for point in points], line, row, what, who)
            row += 22
    for value, color, name in zip(FIELD, (STRIKING, STRUCK), ("striking", "struck")):
        text = f"field: {name} {number(value, True, 0)} %"
        out.append(f'<path d="M{LEFT} {y(value):.1f}H{LEFT + WIDTH}" stroke="{color}" stroke-dasharray="2 3"/>')
        out.append(f'<text x="{LEFT + WIDTH + 14}" y="{y(value) + 4:.1f}" fill="{color}">{text}</text>')
    return "\n".join([*out, "</svg>\n"])


RESULT_COLUMNS = ("space,system,after_collision,estimator,follower,class,emergencies,hits_ahead,hit_from_behind,either,"
                  "activations,harm_per_1000,harm_error_per_1000")


def result_rows(results, spaces):
    """Returns the rows of every system, follower and class in some spaces, in every condition."""
    lines = []
    for (after_collision, estimator), part in results.items():
        for (space, system), drives in part.items():
            if space not in spaces:
                continue
            by_stratum = {}
            for place, stratum in enumerate(drives.strata):
                by_stratum.setdefault(stratum, []).append(place)
            harm = level(drives, "harm")
            for stratum in sorted(by_stratum):
                counts = [f"{sum(getattr(drives, name)[place] for place in by_stratum[stratum]):.0f}"
                          for name in ("ahead", "behind", "any", "activations")]
                mean, variance = harm.moments[stratum]
                row = [space, f'"{system}"', after_collision, estimator, *stratum, str(len(by_stratum[stratum])),
                       *counts, f"{mean:.3f}", f"{variance ** 0.5:.3f}"]
                lines.append(",".join(row))
    return lines


def results_csv(results):
    """Returns the results of one run."""
    return "\n".join([RESULT_COLUMNS, *result_rows(results, [SPACE, *CONFORMING_SPACES])]) + "\n"


def within_csv(runs):
    """Returns the results within the tests, of all runs."""
    rows = [f"{number},{row}" for number, results in enumerate(runs, 1)
            for row in result_rows(results, SPACES_WITHIN_THE_TESTS)]
    return "\n".join([f"run,{RESULT_COLUMNS}", *rows]) + "\n"


def answers_csv(results):
    """Returns every comparison of the questions with its interval."""
    lines = ["question,kind,measure,system,after_collision,estimator,types_of_followers,lorry_percent,change,lower,"
             "upper"]
    for place, question in enumerate(QUESTIONS["questions"], 1):
        for (name, key), bounds in compare(question, results)[0].items():
            lines.append(",".join([str(place), question["kind"], question.get("measure", "any"), f'"{name}"',
                                   *map(str, key), *(f"{value:.3f}" for value in bounds)]))
    return "\n".join(lines) + "\n"


INTRODUCTION = """\
In simulated emergencies, a car brakes to a stop, the car under test follows it, and another vehicle follows that car.
**Speeds, braking and followers are chosen: no value is one of real traffic.**
[Questions](../examples/studies/aeb_behind/questions.toml), rule for answers, statistics and a new seed were
committed before the second of two runs, [but after the first](#changes-after-the-first-run).

Answers hold in both runs, with *sensors* and filter and with the *true state*. A common answer holds in all
COMBINATIONS combinations of three assumptions:

- After an impact, vehicles *hold* their brakes or *coast*.

- Followers: equal shares of [`human`, `idm`, `acc-aeb` and `baseline`](../docs/reference/scenarios.md#drivers)
(*4 types*), or the first three (*3 types*); questions 10 and 11: `human` only (FEW combinations).

- *No lorries* or *half lorries* are among them.

Other answers name combinations whose intervals lie on one side of 0 (question 12: of +20 %). Other combinations are
undecided. Values per 100 emergencies (injuries: per 1000) are the smallest and largest of all combinations, runs and
estimators; brackets those of interval ends (jointly 95 % in each run: COMPARISONS comparisons of EMERGENCIES
emergencies). Combinations share emergencies: they confirm each other little. [Other assumptions](#sensitivity) may
change answers. [Systems](#systems) defines brakes and lead-vehicle tests. *It*: the car under test, *people*:
drivers."""


def sizes(runs):
    """Returns the smallest and the largest number of emergencies of a comparison."""
    found = set()
    for results, (space, kind) in itertools.product(runs, ((SPACE, "change"), ("followers-alone", "left"))):
        strata = results[MAIN][space, HUMAN].strata
        found |= {sum(stratum in weights(followers, lorries) for stratum in strata)
                  for _, _, followers, lorries in combinations(kind)}
    return f"{min(found)} to {max(found)}"


def first_part(runs, fails_s9):
    """Returns the first part of the page: nothing but the answers, and how to read them."""
    estimators = len(QUESTIONS["assumptions"]["estimator"])
    numbers = {"COMBINATIONS": len(combinations("change")) // estimators,
               "FEW": len(combinations("left")) // estimators,
               "COMPARISONS": comparisons(), "EMERGENCIES": sizes(runs)}
    introduction = INTRODUCTION
    for word, value in numbers.items():
        introduction = introduction.replace(word, str(value))
    filled = [textwrap.fill(part, 120, break_on_hyphens=False) for part in introduction.split("\n\n")]
    return "\n".join([TITLE, "", "\n\n".join(filled), "", "## Findings", "", *all_answers(runs, fails_s9), ""])


def cars_table(runs):
    return table(["question 9", "if vehicles hold their brakes", "change", "if vehicles coast", "change"],
                 systems_answers(runs))


def check_first_part(page, wanted, is_written):
    """Refuses a first part that states anything else than the answers, or writes it."""
    text = page.read_text()
    place = text.find("\n## ", text.find("## Findings") + 1)
    if place < 0:
        sys.exit(f"error: {page} has no part after `## Findings`")
    if is_written:
        page.write_text(wanted + text[place:])
    elif text[:place] != wanted:
        rows = zip(text[:place].splitlines() + [""], wanted.splitlines() + [""])
        sys.exit(f"error: the first part of {page} differs from the answers: " + str(next(
            ((a, b) for a, b in rows if a != b), "its length")))


def check_tables(page, made, is_written):
    """Compares tables with the page, or writes them. A table is found by its first line."""
    text = page.read_text()
    for name, block in made.items():
        head = block.split("\n")[0]
        old = re.search(re.escape(head) + r"\n(?:\|.*\n)+", text)
        if old is None:
            sys.exit(f"error: {page} has no table `{name}` with the head {head}")
        if old[0] != block + "\n" and not is_written:
            rows = zip(old[0].splitlines(), block.splitlines())
            sys.exit(f"error: table `{name}` of {page} differs: " + str(next((a, b) for a, b in rows if a != b)))
        text = text.replace(old[0], block + "\n")
    if is_written:
        page.write_text(text)


def count_words(text):
    return len([word for word in text.split() if any(letter.isalnum() for letter in word)])


def check_length(page, first):
    """Refuses a page or a first part that is too long, or a table of more than six columns."""
    text = page.read_text()
    words, words_of_first = count_words(text), count_words(first)
    if words > MAX_WORDS or words_of_first > MAX_WORDS_OF_FIRST_PART:
        sys.exit(f"error: {page} has {words} words, {words_of_first} of them in the first part")
    columns = max((line.count("|") - 1 for line in text.splitlines() if line.startswith("|")), default=0)
    if columns > MAX_COLUMNS:
        sys.exit(f"error: {page} has a table of {columns} columns")
    print(f"The page has {words} words, {words_of_first} of them in the first part, and at most {columns} columns.")


def check_files(page, files, is_written):
    folder = page.with_suffix("")
    for name, text in files.items():
        if is_written:
            (folder / name).write_text(text)
        elif not (folder / name).is_file() or (folder / name).read_text() != text:
            sys.exit(f"error: {folder / name} differs from the runs")


def check_sentences(page, runs):
    """Refuses a page whose sentences state other counts than both runs."""
    count, comparisons_of_all = repeated(runs)
    left, emergencies = within_the_tests(runs, "within-the-tests", CONFORMING)
    without, _ = within_the_tests(runs, "within-the-tests-alone", HUMAN)
    text = " ".join(page.read_text().split())
    for sentence in (f"{count} of {comparisons_of_all} comparisons lie on the same side in both",
                     f"{left} of {emergencies} emergencies of both runs end in a collision",
                     f"without brakes {without} ("):
        if sentence not in text:
            sys.exit(f"error: {page} does not say `{sentence}`")


def check(page, runs, verdicts, is_written):
    """Compares page, pictures and tables of values with both runs, or writes them.

    `verdicts` has whether each system passes every test of S7, and of S9.
    """
    results, others = runs
    first = first_part(runs, verdicts["S9"][CONFORMING] == "no")
    check_first_part(page, first, is_written)
    tables = {"systems": systems_table(results, verdicts["S7"]), "cars": cars_table(runs),
              "followers": followers_table(results), "lorries": lorries_table(results),
              "conforming": conforming_table(results), "field, human": field_table(results, ["human"]),
              "field, four types": field_table(results, FOLLOWERS)}
    check_tables(page, tables, is_written)
    check_sentences(page, runs)
    check_files(page, {"field.svg": field_picture(results), "field.csv": field_csv(results),
                       "results.csv": results_csv(results), "within-the-tests.csv": within_csv(runs),
                       "answers.csv": answers_csv(results), "repeated.csv": answers_csv(others)}, is_written)
    check_length(page, first)
