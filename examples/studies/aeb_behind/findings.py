"""Answers to the questions of the study: those that both runs give, by the rule of `questions.toml`."""

import itertools
import math
import sys
import textwrap

from drives import Stratified, change, interval, level, quantile, weights
from study import CONFORMING, HUMAN, QUESTIONS, SYSTEMS

SPACE = "emergencies"
ASSUMPTIONS = QUESTIONS["assumptions"]
RULE = QUESTIONS["rule"]
# Names of the assumptions, which the introduction of the page explains.
WORDS = {
    "hold": "hold",
    "coast": "coast",
    4: "4 types",
    3: "3 types",
    0: "no lorries",
    50: "half lorries",
}


def combinations(kind):
    """Returns the combinations of assumptions of a question; followers of conforming cars are human."""
    followers = [["human"]] if kind in ("conforming", "left") else ASSUMPTIONS["followers"]
    return list(itertools.product(ASSUMPTIONS["after_collision"], ASSUMPTIONS["estimator"], followers,
                                  ASSUMPTIONS["lorry_percent"]))


def comparisons():
    """Returns the number of all comparisons."""
    return sum(len(combinations(one["kind"])) * len(one.get("after", [0])) for one in QUESTIONS["questions"])


def z():
    return quantile(RULE["error_probability"] / comparisons())


def number(value, is_signed=False, digits=1):
    """Returns a value without a negative zero."""
    text = f"{value:+.{digits}f}" if is_signed else f"{value:.{digits}f}"
    return text.lstrip("+-") if float(text) == 0 else text.replace("-", "−")


def extent(values, is_signed=True, digits=1):
    """Returns the smallest and the largest of some values."""
    low, high = (number(value, is_signed, digits) for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def conforming_values(part, is_ego_conforming, is_follower_conforming, measure):
    """Returns a measure of the drives of human followers; lorries never have the brake."""
    system = CONFORMING if is_ego_conforming else HUMAN
    alone = part["followers-alone", system]
    cars = part["followers-conforming", system] if is_follower_conforming else alone
    of_class = {kind: getattr(drives, measure) for kind, drives in (("light", cars), ("heavy", alone))}
    return [of_class[stratum[1]][place] for place, stratum in enumerate(alone.strata)]


def conforming_level(part, share, measure, of):
    """Returns a measure, and its error, if this share of the cars has the brake, independently of each other."""
    values = {pair: conforming_values(part, *pair, measure) for pair in itertools.product((False, True), repeat=2)}
    alone = part["followers-alone", HUMAN]
    probability = {True: share, False: 1 - share}
    mixed = [sum(probability[ego] * probability[follower] * values[ego, follower][place] for ego, follower in values)
             for place in range(len(alone.strata))]
    return Stratified(alone.strata, mixed, measure).mean(of)


def conforming_change(part, measure, of):
    pairs = zip(conforming_values(part, True, True, measure), conforming_values(part, False, False, measure))
    strata = part["followers-alone", HUMAN].strata
    return Stratified(strata, [after - before for after, before in pairs], measure).mean(of)


def assisted_systems():
    """Returns the human driver, and all human drivers with a brake, by threshold."""
    return [HUMAN] + [name for name in SYSTEMS if name.startswith("human,aeb_ttc_s=")]


def threshold_s(name):
    return float(name.split("=")[1]) if "=" in name else 0.0


def relative_change(part, name, measure, of):
    """Returns the change of a measure against a human without a brake in percent, and its error (delta method)."""
    own, alone = part[SPACE, name], part[SPACE, HUMAN]
    means = [level(drives, measure).mean(of)[0] for drives in (own, alone)]
    ratio = means[0] / means[1]
    linear = [after - ratio * before for after, before in zip(getattr(own, measure), getattr(alone, measure))]
    error = 100 * Stratified(own.strata, linear, measure).mean(of)[1] / means[1]
    return 100 * (ratio - 1), error


def relative_curve(part, of):
    """Returns (threshold, change of striking, change of being struck) against a human without a brake, in percent."""
    return [(threshold_s(name), *(relative_change(part, name, measure, of)[0] for measure in ("ahead", "behind")))
            for name in assisted_systems()]


def struck_where(means, striking):
    """Returns the part of the way between two thresholds at which striking has this change, and the change of being
    struck there. `means` are striking, then being struck: without a brake, at the lower and at the upper threshold."""
    ahead, behind = ([value / of[0] - 1 for value in of[1:]] for of in (means[:3], means[3:]))
    way = (ahead[0] - striking) / (ahead[0] - ahead[1])
    return way, behind[0] + way * (behind[1] - behind[0])


def field_point(part, of, question):
    """Returns the threshold, and the change of being struck in percent with its standard error (delta method)."""
    striking = question["striking"]
    curve = list(zip(assisted_systems(), relative_curve(part, of)))
    for (below, (low_s, low, _)), (above, (high_s, high, _)) in zip(curve, curve[1:]):
        if low >= 100 * striking > high:
            break
    else:
        return None
    values = [getattr(part[SPACE, name], measure) for measure in ("ahead", "behind") for name in (HUMAN, below, above)]
    strata = part[SPACE, HUMAN].strata
    means = [Stratified(strata, of_system, "ahead").mean(of)[0] for of_system in values]
    way, struck = struck_where(means, striking)
    slopes = []
    for place, mean in enumerate(means):
        step = 1e-4 * mean
        higher, lower = (struck_where([*means[:place], mean + sign * step, *means[place + 1:]], striking)[1]
                         for sign in (1, -1))
        slopes.append((higher - lower) / (2 * step))
    linear = [sum(slope * value for slope, value in zip(slopes, row)) for row in zip(*values)]
    error = Stratified(strata, linear, "ahead", has_floor=False).mean(of)[1]
    return low_s + way * (high_s - low_s), (100 * struck, 100 * error)


def compare(question, results):
    """Returns {(system, combination): (mean, lower, upper)}, and the thresholds of a question about the field."""
    found, thresholds = {}, []
    for combination in combinations(question["kind"]):
        after_collision, estimator, followers, lorries = combination
        part, of = results[after_collision, estimator], weights(followers, lorries)
        key = (after_collision, estimator, len(followers), lorries)
        if question["kind"] == "change":
            for name in question["after"]:
                changed = change(part[SPACE, name], part[SPACE, question["before"]], question["measure"])
                found[name, key] = interval(changed.mean(of), z())
        elif question["kind"] == "conforming":
            found["all", key] = interval(conforming_change(part, "any", of), z())
        elif question["kind"] == "left":
            found["all", key] = interval(conforming_level(part, 1.0, "any", of), z())
        else:
            point = field_point(part, of, question)
            if point:
                thresholds.append(point[0])
                found["all", key] = interval(point[1], z())
    return found, thresholds


def side(bounds, reference=0.0):
    """Returns 1 or -1 if an interval lies on one side of the reference, otherwise 0."""
    return int(bounds[1] > reference) - int(bounds[2] < reference)


def reference_of(question):
    """Returns the value with which the intervals of a question are compared."""
    return {"left": question.get("limit"), "field": 100 * question.get("struck", 0)}.get(question["kind"], 0.0)


def joined(question, runs):
    """Returns {system: {(after_collision, types of followers, lorry_percent): intervals}}, and the thresholds.

    The intervals are those of all runs with both estimators, which give nearly the same results.
    """
    by_system, thresholds = {}, []
    for results in runs:
        found, of_run = compare(question, results)
        thresholds += of_run
        for (name, (after_collision, _, followers, lorries)), bounds in found.items():
            combination = (after_collision, followers, lorries)
            by_system.setdefault(name, {}).setdefault(combination, []).append(bounds)
    return by_system, thresholds


def common_sides(found, reference=0.0):
    """Returns the side of the intervals of each combination: 0 unless all of them have the same."""
    sides = {key: {side(bounds, reference) for bounds in intervals} for key, intervals in found.items()}
    return {key: of.pop() if len(of) == 1 else 0 for key, of in sides.items()}


def intervals_of(found):
    """Returns the intervals of all combinations."""
    return [bounds for intervals in found.values() for bounds in intervals]


def holds(conjunction, combination):
    """Returns true if a combination has all values of a conjunction; `None` stands for any value."""
    return all(value in (None, own) for value, own in zip(conjunction, combination))


def length(conjunctions):
    """Returns the number of values that some conjunctions name."""
    return sum(value is not None for conjunction in conjunctions for value in conjunction)


def cover(combinations_of_all, wanted):
    """Returns the shortest list of conjunctions of assumptions that hold in exactly the wanted combinations."""
    values = [[None, *dict.fromkeys(of)] for of in zip(*combinations_of_all)]
    held = {conjunction: {one for one in combinations_of_all if holds(conjunction, one)}
            for conjunction in itertools.product(*values)}
    inside = [one for one in held if held[one] and held[one] <= wanted]
    largest = [one for one in inside if not any(held[one] < held[other] for other in inside)]
    covers = (chosen for count in range(1, len(largest) + 1) for chosen in itertools.combinations(largest, count)
              if set().union(*(held[one] for one in chosen)) == wanted)
    first = next(covers)
    shortest = min([first, *itertools.takewhile(lambda chosen: len(chosen) == len(first), covers)], key=length)
    return sorted(shortest, key=lambda conjunction: (len(conjunction) - conjunction.count(None),
                                                     [value is None for value in conjunction]))


def in_words(conjunctions, start):
    """Returns conjunctions as a phrase."""
    parts = [" & ".join(f"*{WORDS[value]}*" for value in conjunction if value is not None)
             for conjunction in conjunctions]
    return f"{start} " + ", or ".join(parts)


def condition(sides, wanted):
    """Returns the assumptions under which combinations have the wanted side, as a phrase; empty if all have it."""
    own = {key for key, value in sides.items() if value == wanted}
    if len(own) == len(sides):
        return ""
    only, unless = cover(list(sides), own), cover(list(sides), set(sides) - own)
    return in_words(unless, "except with") if len(unless) < len(only) else in_words(only, "with")


def conditional(sides, words):
    """Returns each answer that some combinations have, with its condition."""
    return "; ".join(f"{word} {condition(sides, wanted)}".strip() for wanted, word in words.items()
                     if wanted in sides.values()) or "every interval contains 0"


def spans(intervals, is_signed=True, digits=1):
    """Returns the extent of the values, and that of the ends of their intervals."""
    ends = [end for bounds in intervals for end in bounds[1:]]
    low, high = (number(end, is_signed, digits) for end in (min(ends), max(ends)))
    return extent([bounds[0] for bounds in intervals], is_signed, digits), f"{low}…{high}"


CHANGES = {1: "more", -1: "fewer"}
NO_ANSWER = "No common answer"


def verdict(found, limit):
    """Returns the answer of one comparison in all combinations."""
    sides, intervals = common_sides(found), intervals_of(found)
    values = "{} ({}).".format(*spans(intervals))
    for wanted, word in CHANGES.items():
        if all(value == wanted for value in sides.values()):
            return f"{word.capitalize()}: {values}"
    if limit and all(-limit < bounds[1] and bounds[2] < limit for bounds in intervals):
        return f"The change is less than {limit:g}: {values}"
    return f"{NO_ANSWER} ({conditional(sides, CHANGES)}): {values}"


def answer_of_change(question, by_system):
    if len(by_system) == 1:
        return verdict(*by_system.values(), RULE["limit"][question["measure"]])
    systems = {}
    for name, found in by_system.items():
        systems.setdefault(conditional(common_sides(found), CHANGES), []).append(f"`{name}`")
    most = max(systems, key=lambda parts: len(systems[parts]))
    others = "".join(f"; {', '.join(names)}: {parts}" for parts, names in systems.items() if parts != most)
    span, ends = spans([bounds for found in by_system.values() for bounds in intervals_of(found)])
    count = sum(verdict(found, RULE["limit"][question["measure"]]).startswith(NO_ANSWER)
                for found in by_system.values())
    return (f"{NO_ANSWER} for {count} of {len(by_system)} models, extrapolated here "
            f"({len(systems[most])} cars: {most}{others}): {span} ({ends}).")


def upper_bound(failures, runs, error_probability):
    """Returns the one-sided upper bound of Clopper and Pearson of a probability."""
    low, high = failures / runs, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        at_most = sum(math.comb(runs, count) * middle ** count * (1 - middle) ** (runs - count)
                      for count in range(failures + 1))
        low, high = (middle, high) if at_most > error_probability else (low, middle)
    return high


def within_the_tests(runs, space, system):
    """Returns how many emergencies of all runs within the tests end in a collision, and how many there are.

    The first number is the largest of the motions after an impact and of the estimators.
    """
    drives = [[results[condition][space, system] for results in runs] for condition in runs[0]]
    return (max(round(sum(sum(of.any) for of in of_runs)) for of_runs in drives),
            sum(len(of.any) for of in drives[0]))


def answer_of_left(question, found, runs, fails_s9):
    """Returns the answer about collisions that are left, with its reversal within the tests."""
    intervals = intervals_of(found)
    span, ends = spans(intervals, False)
    is_left = all(bounds[1] > question["limit"] for bounds in intervals)
    word = "No" if is_left else NO_ANSWER
    count, emergencies = within_the_tests(runs, "within-the-tests", CONFORMING)
    upper = 100 * upper_bound(count, emergencies, RULE["error_probability"] / comparisons())
    if upper >= question["limit"] or not fails_s9:
        sys.exit("error: the sentence about collisions within the tests holds no longer")
    return (f"{word}, in these emergencies: {span} ({ends}) end in a collision; limit "
            f"{question['limit']:g}. **Yes, at 36 to 80 km/h and at most 4.9 m/s²**, on dry roads without lorries: "
            f"{100 * count / emergencies:.1f} (at most {upper:.1f}). The brake fails the tests of unnecessary "
            "braking ([S9](#if-all-cars-conform)).")


def answer_of_field(question, runs, found, thresholds):
    """Returns the answer about the field."""
    intervals, reference = intervals_of(found), reference_of(question)
    if len(intervals) < len(combinations("field")) * len(runs):
        return "No answer: in some combinations no threshold up to 3 s halves the collisions ahead."
    parts = conditional(common_sides(found, reference), {-1: "lower", 1: "higher"})
    span, ends = spans(intervals, digits=0)
    return (f"{NO_ANSWER} ({parts}): {span} % ({ends} %), for brakes from {extent(thresholds, False)} s "
            "([field](#compared-with-the-field)).")


def answer(question, runs, fails_s9):
    """Returns the sentence that answers a question."""
    by_system, thresholds = joined(question, runs)
    kind = question["kind"]
    if kind == "change":
        return answer_of_change(question, by_system)
    if kind == "conforming":
        return verdict(by_system["all"], 0)
    if kind == "left":
        return answer_of_left(question, by_system["all"], runs, fails_s9)
    return answer_of_field(question, runs, by_system.get("all", {}), thresholds)


def repeated(runs):
    """Returns the number of comparisons with the same side in both runs, and that of all.

    Sides are those of 0, of the limit of the collisions that are left, or of the field's value.
    """
    counts = [0, 0]
    for question in QUESTIONS["questions"]:
        reference = reference_of(question)
        first, second = (compare(question, results)[0] for results in runs)
        counts[0] += sum(key in second and side(bounds, reference) == side(second[key], reference)
                         for key, bounds in first.items())
        counts[1] += len(first)
    return counts


def all_answers(runs, fails_s9):
    """Returns the list of questions with their answers."""
    lines = [f"{place}. **{question['text']}** {answer(question, runs, fails_s9)}"
             for place, question in enumerate(QUESTIONS["questions"], 1)]
    return [textwrap.fill(line, 140, subsequent_indent="   ", break_long_words=False, break_on_hyphens=False)
            for line in lines]


def systems_answers(runs):
    """Returns a row for each system of the question about several: its answers by the motion after an impact."""
    question = next(one for one in QUESTIONS["questions"] if len(one.get("after", [])) > 1)
    rows = []
    for name, found in joined(question, runs)[0].items():
        row = [f"`{name}`"]
        for after_collision in ASSUMPTIONS["after_collision"]:
            part = {key: intervals for key, intervals in found.items() if key[0] == after_collision}
            row += [conditional(common_sides(part), CHANGES), "{} ({})".format(*spans(intervals_of(part)))]
        rows.append(row)
    return rows
