//! Properties of the controller. A failing test prints the simplest scenario found, and keeps it in `crumple-corpus`.

use crumple_testing::{ControllerCheck, Property, check, stateless};

fn controller() -> ControllerCheck {
    check(stateless(my_controller::decide))
}

#[test]
fn answers_every_observation() {
    controller()
        .on("any")
        .property(Property::deterministic())
        .cases(100)
        .assert();
}

#[test]
fn avoids_avoidable_collisions() {
    controller()
        .on("alone")
        .property(Property::no_avoidable_collision())
        .cases(100)
        .assert();
}

#[test]
fn never_brakes_unnecessarily() {
    controller()
        .on("traffic")
        .property(Property::no_unnecessary_braking())
        .cases(50)
        .assert();
}
