"""Properties of the controller. A failing test names the file of the simplest scenario found."""

from hypothesis import HealthCheck, given, settings
from my_controller import decide

from crumple import testing
from crumple.testing import Property

slow = settings(deadline=None, max_examples=50, suppress_health_check=[HealthCheck.too_slow])


@slow
@given(testing.any_scenario())
def test_it_answers_every_observation(scenario):
    testing.check(decide, scenario, Property.deterministic())


@slow
@given(testing.scenarios("alone"))
def test_it_avoids_avoidable_collisions(scenario):
    testing.check(decide, scenario, Property.no_avoidable_collision())


@slow
@given(testing.scenarios("traffic"))
def test_it_never_brakes_unnecessarily(scenario):
    testing.check(decide, scenario, Property.no_unnecessary_braking())
