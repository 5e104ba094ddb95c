"""A second simulator of the study, written from the pages of the documentation alone. Needs only Python 3.11.

The author had seen neither the source of crumple nor its results. No code and no random number is shared. The first
of three vehicles follows a script; controllers drive the second and the third. Sources of the rules:
../emergencies.toml and docs/reference/spaces.md (distributions, derived fields), vehicles.md (classes, from command to
acceleration) and scenarios.md (scripts, default settings) beside it, docs/mathematics.md (controllers, the driver
`human`, after a collision), docs/controllers.md and docs/reference/observations.md (the true state, with the
accelerations of the last step), reports/aeb-behind.md (a car that is pushed into the vehicle ahead counts as hit from
behind only).

The pages left choices open for `human`: what brake lights show after an impact and at standstill, which of two reasons
decides the reaction, the distribution of glances, and levels outside their range. docs/mathematics.md states these
rules since the first comparison (reports/aeb-behind.md). An author who knows the source then changed this program to
follow the page.

A run ends when the third vehicle hits the second: nothing that happens later counts.
"""

import math
import random

STEP_S = 0.01
HALF_STEP_S = STEP_S / 2.0  # durations of `human` are rounded to steps
NEVER_S = math.inf
FULL_BRAKE_MPS2 = 1000.0  # limited by vehicle and friction
HOLD_BRAKE_MPS2 = 6.0
SURELY_APART_M = 1.0  # no two vehicles collide within a step from a larger gap
CLASSES = {"light": {"max_brake_mps2": 7.5, "max_accel_mps2": 3.0},
           "heavy": {"max_brake_mps2": 6.0, "max_accel_mps2": 1.5}}
IDM = {"desired_speed_mps": 33.3, "time_headway_s": 1.6, "standstill_gap_m": 2.0, "accel_mps2": 0.73,
       "comfortable_brake_mps2": 1.67}
ACC_AEB = {"ttc_s": 1.4, "time_headway_s": 0.8, "standstill_gap_m": 2.0, "gap_gain_per_s2": 0.25,
           "speed_gain_per_s": 0.8, "comfort_brake_mps2": 3.5, "comfort_accel_mps2": 2.0}
HUMAN = {"reaction_s": 1.25, "surprise_s": 1.5, "reaction_shape": 0.42, "looming_rad_per_s": 0.003, "brake_mps2": 5.0,
         "brake_deviation_mps2": 1.2, "glance_per_s": 0.1, "glance_s": 0.8, "glance_shape": 0.5,
         "time_headway_s": 1.6, "aeb_ttc_s": 0.0, "aeb_brake_mps2": 7.5}
DEFAULTS = {"idm": IDM, "baseline": {"ttc_s": 1.4}, "acc-aeb": ACC_AEB, "human": HUMAN,
            "emergency-brake": {"ttc_s": 1.4, "brake_mps2": 7.5}}
SHORTEST_HUMAN_TIME_GAP_S = 0.3
HUMAN_BRAKE_RANGE_MPS2 = (2.0, 9.1)
SEEN_WIDTH_M = 1.8
BRAKE_LIGHTS_MPS2 = 1.0
FOOT_OFF_BRAKE_MPS2 = 0.5


def truncated_normal(generator, mean, deviation, low, high):
    """A number of the normal distribution, drawn again until it lies in the range."""
    while True:
        value = generator.gauss(mean, deviation)
        if low <= value <= high:
            return value


def log_normal(generator, median, shape):
    """A log-normal number with this median and this standard deviation of the logarithm."""
    return median * math.exp(generator.gauss(0.0, shape))


def draw(generator, distribution):
    """A random number of a distribution of the space (spaces.md)."""
    (kind, fields), = distribution.items()
    if kind == "uniform":
        return generator.uniform(fields["low"], fields["high"])
    if kind == "normal":
        return truncated_normal(generator, fields["mean"], fields["deviation"], fields["low"], fields["high"])
    if kind == "histogram":
        edges = fields["edges"]
        bin_index, = generator.choices(range(len(edges) - 1), fields["weights"])
        return generator.uniform(edges[bin_index], edges[bin_index + 1])
    raise ValueError(f"unknown distribution {kind}")


def make_idm(settings):
    """The Intelligent Driver Model as a function of gap, own speed and (perceived) closing speed."""
    desired_speed_mps, time_headway_s, standstill_gap_m, accel_mps2, brake_mps2 = settings.values()
    closing_scale_mps2 = 2.0 * math.sqrt(accel_mps2 * brake_mps2)

    def accelerate(gap_m, speed_mps, closing_mps):
        """Acceleration in m/s² (Treiber, Hennecke and Helbing 2000, equations 3 and 4)."""
        wanted_gap_m = speed_mps * time_headway_s + speed_mps * closing_mps / closing_scale_mps2
        wanted_gap_m = standstill_gap_m + (wanted_gap_m if wanted_gap_m > 0.0 else 0.0)
        gap_share = wanted_gap_m / (gap_m if gap_m > 0.01 else 0.01)
        return accel_mps2 * (1.0 - (speed_mps / desired_speed_mps) ** 4 - gap_share * gap_share)
    return accelerate


def make_brake(ttc_s, brake_mps2, to_standstill):
    """A brake that fires at a time to collision; it is released when the vehicle no longer closes in, or never."""
    braking = False

    def brake(gap_m, speed_mps, closing_mps):
        """Command in m/s²."""
        nonlocal braking
        braking = (braking and (to_standstill or closing_mps > 0.0)) or gap_m < ttc_s * closing_mps
        return -brake_mps2 if braking else 0.0
    return brake


def make_acc_aeb(settings):
    """The controller `acc-aeb` without a set speed: cruise control with an emergency brake."""
    ttc_s, time_headway_s, standstill_m, gap_gain_per_s2, speed_gain_per_s, brake_mps2, accel_mps2 = settings.values()

    def accelerate(gap_m, speed_mps, closing_mps):
        """Command in m/s²."""
        if gap_m < ttc_s * closing_mps:
            return -FULL_BRAKE_MPS2
        follow_mps2 = gap_gain_per_s2 * (gap_m - standstill_m - time_headway_s * speed_mps)
        follow_mps2 -= speed_gain_per_s * closing_mps
        catch_up_mps2 = max(speed_gain_per_s * (2.0 - closing_mps), 0.0)
        return max(min(follow_mps2, catch_up_mps2, accel_mps2), -brake_mps2)
    return accelerate


class HumanDriver:
    """The driver `human`, and the emergency brake of its car (mathematics.md)."""

    def __init__(self, settings, generator, gap_m, speed_mps):
        """Draws the traits of a driver whose first observation is this gap and speed."""
        self.random, self.glance = generator, (settings["glance_s"], settings["glance_shape"])
        shape = settings["reaction_shape"]
        factor = log_normal(generator, math.exp(-shape * shape / 2.0), shape)  # its mean is 1
        self.reaction_s, self.surprise_s = settings["reaction_s"] * factor, settings["surprise_s"] * factor
        weakest_mps2, hardest_mps2 = HUMAN_BRAKE_RANGE_MPS2
        level_mps2 = generator.gauss(settings["brake_mps2"], settings["brake_deviation_mps2"])
        self.level_mps2 = min(max(level_mps2, weakest_mps2), hardest_mps2)
        time_gap_s = min((gap_m - IDM["standstill_gap_m"]) / speed_mps, settings["time_headway_s"])
        self.accelerate = make_idm(IDM | {"desired_speed_mps": max(IDM["desired_speed_mps"], speed_mps),
                                          "time_headway_s": max(time_gap_s, SHORTEST_HUMAN_TIME_GAP_S)})
        self.emergency_brake = make_brake(settings["aeb_ttc_s"], settings["aeb_brake_mps2"], False)
        self.has_emergency_brake, self.looming_rad_per_s = settings["aeb_ttc_s"] > 0.0, settings["looming_rad_per_s"]
        self.glance_chance = settings["glance_per_s"] * STEP_S
        self.foot_on_brake_at_s, self.pedals_mps2, self.glance_ends_at_s = NEVER_S, 0.0, 0.0

    def decide(self, time_s, gap_m, speed_mps, closing_mps, leader_accel_mps2):
        """Command in m/s²: the harder one of driver and emergency brake."""
        if time_s + HALF_STEP_S >= self.glance_ends_at_s:
            self.look(time_s, gap_m, speed_mps, closing_mps, leader_accel_mps2)
        if self.has_emergency_brake and (brake_mps2 := self.emergency_brake(gap_m, speed_mps, closing_mps)) < 0.0:
            return min(self.pedals_mps2, brake_mps2)
        return self.pedals_mps2

    def look(self, time_s, gap_m, speed_mps, closing_mps, leader_accel_mps2):
        """Perceives the leader and moves the pedals. A driver without a reason to brake may then glance elsewhere."""
        had_reason = self.foot_on_brake_at_s < NEVER_S
        expansion_rad_per_s = SEEN_WIDTH_M * closing_mps / (gap_m * gap_m + SEEN_WIDTH_M * SEEN_WIDTH_M / 4.0)
        perceived_mps = closing_mps if abs(expansion_rad_per_s) > self.looming_rad_per_s else 0.0
        is_lit = leader_accel_mps2 <= -BRAKE_LIGHTS_MPS2
        if not (is_lit or perceived_mps > 0.0 or (had_reason and closing_mps > 0.0)):
            self.foot_on_brake_at_s = NEVER_S
        elif not had_reason:
            self.foot_on_brake_at_s = time_s + (self.reaction_s if is_lit else self.surprise_s)
        is_braking = time_s + HALF_STEP_S >= self.foot_on_brake_at_s
        hardest_mps2 = self.level_mps2 if is_braking else FOOT_OFF_BRAKE_MPS2
        self.pedals_mps2 = max(self.accelerate(gap_m, speed_mps, perceived_mps), -hardest_mps2)
        if not had_reason and self.random.random() < self.glance_chance:
            glance_s = log_normal(self.random, *self.glance)
            self.glance_ends_at_s = time_s + STEP_S + glance_s
            self.foot_on_brake_at_s += glance_s  # a reaction waits for the end of the glance


def make_controller(text, generator, gap_m, speed_mps):
    """The function that decides for a controller such as `human,aeb_ttc_s=2`, in a vehicle with this gap and speed."""
    name, *changes = text.split(",")
    settings = DEFAULTS[name] | {field: float(value) for field, value in (change.split("=") for change in changes)}
    if settings.keys() != DEFAULTS[name].keys():
        raise ValueError(f"unknown setting in {text}")
    if name == "human":
        return HumanDriver(settings, generator, gap_m, speed_mps).decide
    if name in ("baseline", "emergency-brake"):
        command = make_brake(settings["ttc_s"], settings.get("brake_mps2", FULL_BRAKE_MPS2), name == "baseline")
    else:
        command = {"idm": make_idm, "acc-aeb": make_acc_aeb}[name](settings)
    return lambda time_s, gap_m, speed_mps, closing_mps, leader_accel_mps2: command(gap_m, speed_mps, closing_mps)


def collision_time_s(gap_m, closing_mps, closing_change_mps2):
    """Time until a gap closes at a speed that changes at a constant rate: the first root of a quadratic."""
    discriminant = closing_mps * closing_mps + 2.0 * closing_change_mps2 * gap_m
    if discriminant < 0.0:
        return NEVER_S
    divisor_mps = closing_mps + math.sqrt(discriminant)
    return 2.0 * gap_m / divisor_mps if divisor_mps > 0.0 else NEVER_S


class Line:
    """Motion of the three vehicles: gaps and speeds, and which of them have collided."""

    def __init__(self, speed_mps, gap_ahead_m, gap_behind_m):
        """All vehicles drive at one speed."""
        self.speeds_mps = [speed_mps] * 3
        self.gap_ahead_m, self.gap_behind_m = gap_ahead_m, gap_behind_m
        self.hit_ahead = self.hit_behind = False
        self.observed_mps2 = (0.0, 0.0, 0.0)  # accelerations in the last step, after a collision in it those since then

    def effective(self, first_mps2, second_mps2, third_mps2):
        """Accelerations of the motion: collided vehicles are one body, and no vehicle reverses."""
        first_mps, second_mps, third_mps = self.speeds_mps
        if self.hit_ahead:
            first_mps2 = second_mps2 = (first_mps2 + second_mps2) / 2.0  # equal masses, of the class `light`
        return (first_mps2 if first_mps > 0.0 or first_mps2 > 0.0 else 0.0,
                second_mps2 if second_mps > 0.0 or second_mps2 > 0.0 else 0.0,
                third_mps2 if third_mps > 0.0 or third_mps2 > 0.0 else 0.0)

    def move(self, duration_s, first_mps2, second_mps2, third_mps2):
        """Motion without events."""
        first_mps, second_mps, third_mps = self.speeds_mps
        half_s2 = duration_s * duration_s / 2.0
        self.gap_ahead_m += (first_mps - second_mps) * duration_s + (first_mps2 - second_mps2) * half_s2
        self.gap_behind_m += (second_mps - third_mps) * duration_s + (second_mps2 - third_mps2) * half_s2
        self.speeds_mps = [first_mps + first_mps2 * duration_s, second_mps + second_mps2 * duration_s,
                           third_mps + third_mps2 * duration_s]

    def next_event(self, effective_mps2):
        """Time until the next stop or collision, and what it is: number of a vehicle, `ahead` or `behind`."""
        events = [(-speed_mps / accel_mps2, index) for index, (speed_mps, accel_mps2)
                  in enumerate(zip(self.speeds_mps, effective_mps2)) if accel_mps2 < 0.0]
        first_mps, second_mps, third_mps = self.speeds_mps
        if not self.hit_ahead:
            change_mps2 = effective_mps2[1] - effective_mps2[0]
            events.append((collision_time_s(self.gap_ahead_m, second_mps - first_mps, change_mps2), "ahead"))
        change_mps2 = effective_mps2[2] - effective_mps2[1]
        events.append((collision_time_s(self.gap_behind_m, third_mps - second_mps, change_mps2), "behind"))
        return min(events, key=lambda event: event[0])

    def step(self, accels_mps2):
        """One step of the scenario with constant accelerations, exact stops and exact times of collisions."""
        remaining_s = STEP_S
        accels_mps2 = self.observed_mps2 = self.effective(*accels_mps2)
        while not self.hit_behind:
            first_mps2, second_mps2, third_mps2 = effective_mps2 = self.effective(*accels_mps2)
            first_mps, second_mps, third_mps = self.speeds_mps
            event_s, event = NEVER_S, None
            if (self.gap_behind_m < SURELY_APART_M or (self.gap_ahead_m < SURELY_APART_M and not self.hit_ahead)
                    or first_mps + first_mps2 * remaining_s < 0.0 or second_mps + second_mps2 * remaining_s < 0.0
                    or third_mps + third_mps2 * remaining_s < 0.0):
                event_s, event = self.next_event(effective_mps2)
            if event_s > remaining_s:
                return self.move(remaining_s, *effective_mps2)
            self.move(event_s, *effective_mps2)
            remaining_s -= event_s
            if event == "ahead":
                self.hit_ahead = True
                self.speeds_mps[:2] = [sum(self.speeds_mps[:2]) / 2.0] * 2
                self.observed_mps2 = self.effective(*accels_mps2)
            elif event == "behind":
                self.hit_behind = True
            else:
                self.speeds_mps[event] = 0.0


def run_emergency(figure, follower_class, space, generator):
    """Simulates one emergency: whether the second vehicle hits the first, and whether the third hits the second."""
    numbers = {parameter["name"]: draw(generator, parameter["distribution"]) for parameter in space["parameters"]
               if "choice" not in parameter["distribution"]}  # driver and class of the follower are given
    speed_mps, friction = numbers["speed_mps"], numbers["friction"]
    gap_ahead_m, gap_behind_m = (speed_mps * numbers[f"time_gap_{side}_s"] for side in ("ahead", "behind"))
    second, third = CLASSES["light"], CLASSES[follower_class]
    line = Line(speed_mps, gap_ahead_m, gap_behind_m)
    decide_second = make_controller(figure["controller"], generator, gap_ahead_m, speed_mps)
    decide_third = make_controller(figure["follower"], generator, gap_behind_m, speed_mps)
    lead_brake_mps2 = numbers["lead_brake_share"] * friction * space["base"]["vehicles"][0]["max_brake_mps2"]
    second_low_mps2, second_high_mps2 = -second["max_brake_mps2"] * friction, second["max_accel_mps2"]
    third_low_mps2 = -(third["max_brake_mps2"] + numbers["follower_brake_offset_mps2"]) * friction
    collided_mps2 = {"hold": max(-HOLD_BRAKE_MPS2, second_low_mps2), "coast": 0.0}[figure["after_collision"]]
    for step in range(round(space["base"]["duration_s"] / STEP_S)):
        time_s = step * STEP_S
        first_mps, second_mps, third_mps = line.speeds_mps
        ahead_mps2, own_mps2, _ = line.observed_mps2  # of the leader of the second vehicle, and of that of the third
        command_mps2 = decide_third(time_s, line.gap_behind_m, third_mps, third_mps - second_mps, own_mps2)
        third_mps2 = min(max(command_mps2, third_low_mps2), third["max_accel_mps2"])
        if line.hit_ahead:
            second_mps2 = collided_mps2
        else:
            command_mps2 = decide_second(time_s, line.gap_ahead_m, second_mps, second_mps - first_mps, ahead_mps2)
            second_mps2 = min(max(command_mps2, second_low_mps2), second_high_mps2)
        first_mps2 = -lead_brake_mps2 * min(max((time_s + STEP_S - numbers["lead_onset_s"]) / STEP_S, 0.0), 1.0)
        line.step((first_mps2, second_mps2, third_mps2))
        if line.hit_behind:
            break
    return {"ahead": line.hit_ahead, "behind": line.hit_behind}


def simulate(figure, seed, count, space):
    """Returns {measure: {vehicle class: (collisions, emergencies)}}; every other emergency has a lorry behind."""
    run_name = f"{figure['controller']} {figure['follower']} {figure['after_collision']}"
    collisions = {measure: dict.fromkeys(CLASSES, 0) for measure in ("ahead", "behind")}
    emergencies = dict.fromkeys(CLASSES, 0)
    for number in range(count):
        follower_class = ("light", "heavy")[number % 2]
        hits = run_emergency(figure, follower_class, space, random.Random(f"{seed} {run_name} {number}"))
        emergencies[follower_class] += 1
        for measure, hit in hits.items():
            collisions[measure][follower_class] += hit
    return {measure: {name: (hit_count, emergencies[name]) for name, hit_count in by_class.items()}
            for measure, by_class in collisions.items()}
