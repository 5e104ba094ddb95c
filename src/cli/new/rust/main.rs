//! Makes the controller a process, for `crumple ... --controller controller.toml`.

use crumple_sim::control::{ServingError, serve, stateless};

fn main() -> Result<(), ServingError> {
    serve("my-controller", &*stateless(my_controller::decide))
}
