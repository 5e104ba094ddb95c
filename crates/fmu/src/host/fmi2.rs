//! The calls of FMI 2.0 (chapters 2.1 and 4.2), for co-simulation.

#![allow(unsafe_code)]

use std::ffi::{CStr, CString, c_char, c_int, c_uint, c_void};
use std::io::Write as _;
use std::ptr;

use libloading::{Library, Symbol};

use super::instance::{Calls, Made, Wire, checked, not_loaded, resources};
use crate::Kind;

type Component = *mut c_void;
type Status = c_int;
type Logger = extern "C" fn(*mut c_void, *const c_char, Status, *const c_char, *const c_char);

unsafe extern "C" {
    fn calloc(count: usize, size: usize) -> *mut c_void;
    fn free(memory: *mut c_void);
}

/// `fmi2CallbackFunctions`.
#[repr(C)]
struct Callbacks {
    logger: Logger,
    allocate_memory: unsafe extern "C" fn(usize, usize) -> *mut c_void,
    free_memory: unsafe extern "C" fn(*mut c_void),
    step_finished: *const c_void,
    environment: *mut c_void,
}

/// The logger of the standard takes more arguments, which are for its message as for `printf`. A function that does not look at
/// them is called the same way by the C conventions of x86-64 and of AArch64, so they are left where they are.
extern "C" fn log(_: *mut c_void, _: *const c_char, status: Status, _: *const c_char, message: *const c_char) {
    told(status, message);
}

type Instantiate = unsafe extern "C" fn(
    *const c_char,
    c_int,
    *const c_char,
    *const c_char,
    *const Callbacks,
    c_int,
    c_int,
) -> Component;
type OfComponent = unsafe extern "C" fn(Component) -> Status;
type Free = unsafe extern "C" fn(Component);
type Setup = unsafe extern "C" fn(Component, c_int, f64, f64, c_int, f64) -> Status;
type DoStep = unsafe extern "C" fn(Component, f64, f64, c_int) -> Status;
type SetReal = unsafe extern "C" fn(Component, *const c_uint, usize, *const f64) -> Status;
type SetInteger = unsafe extern "C" fn(Component, *const c_uint, usize, *const c_int) -> Status;
type GetReal = unsafe extern "C" fn(Component, *const c_uint, usize, *mut f64) -> Status;

/// An FMU of FMI 2.0.
pub(super) struct Fmi2 {
    instantiate: Instantiate,
    free: Free,
    reset: OfComponent,
    setup: Setup,
    enter: OfComponent,
    exit: OfComponent,
    terminate: OfComponent,
    do_step: DoStep,
    set_real: SetReal,
    set_integer: SetInteger,
    set_boolean: SetInteger,
    get_real: GetReal,
    token: CString,
    resources: CString,
    callbacks: Box<Callbacks>,
    component: Component,
    /// The functions above are its own: it is closed after all of them.
    _library: Library,
}

impl Fmi2 {
    pub(super) fn load(made: &Made<'_>) -> Result<Self, String> {
        let text = |text: &str| CString::new(text).map_err(|_| format!("{text:?} holds a NUL"));
        let location = format!("file://{}", percent_encoded(&resources(made.folder).to_string_lossy()));
        // SAFETY: loading runs the library's initializers, which is what this process is for.
        let library = unsafe { Library::new(made.library) }.map_err(|error| not_loaded(&error, made.folder))?;
        Ok(Self {
            instantiate: function(&library, c"fmi2Instantiate")?,
            free: function(&library, c"fmi2FreeInstance")?,
            reset: function(&library, c"fmi2Reset")?,
            setup: function(&library, c"fmi2SetupExperiment")?,
            enter: function(&library, c"fmi2EnterInitializationMode")?,
            exit: function(&library, c"fmi2ExitInitializationMode")?,
            terminate: function(&library, c"fmi2Terminate")?,
            do_step: function(&library, c"fmi2DoStep")?,
            set_real: function(&library, c"fmi2SetReal")?,
            set_integer: function(&library, c"fmi2SetInteger")?,
            set_boolean: function(&library, c"fmi2SetBoolean")?,
            get_real: function(&library, c"fmi2GetReal")?,
            token: text(&made.description.token)?,
            resources: text(&location)?,
            callbacks: Box::new(Callbacks {
                logger: log,
                allocate_memory: calloc,
                free_memory: free,
                step_finished: ptr::null(),
                environment: ptr::null_mut(),
            }),
            component: ptr::null_mut(),
            _library: library,
        })
    }
}

impl Calls for Fmi2 {
    fn instantiate(&mut self) -> Result<(), String> {
        /// `fmi2CoSimulation`.
        const CO_SIMULATION: c_int = 1;
        let (token, resources, callbacks) = (self.token.as_ptr(), self.resources.as_ptr(), &raw const *self.callbacks);
        // SAFETY: the texts end in NUL; they and the callbacks live as long as the instance, and do not move.
        self.component =
            unsafe { (self.instantiate)(c"crumple".as_ptr(), CO_SIMULATION, token, resources, callbacks, 0, 0) };
        if self.component.is_null() { Err("the FMU gives no instance (fmi2Instantiate)".to_owned()) } else { Ok(()) }
    }

    fn reset(&mut self) -> Result<(), String> {
        // SAFETY: the component is an instance of this library.
        checked("fmi2Reset", unsafe { (self.reset)(self.component) })
    }

    fn set(&mut self, wire: Wire, value: f64) -> Result<(), String> {
        let reference = &raw const wire.reference;
        let whole = value as c_int;
        // SAFETY: one reference, and one value, which are read before the call returns.
        let (call, status) = unsafe {
            match wire.kind {
                Kind::Real => ("fmi2SetReal", (self.set_real)(self.component, reference, 1, &raw const value)),
                Kind::Integer => ("fmi2SetInteger", (self.set_integer)(self.component, reference, 1, &raw const whole)),
                Kind::Boolean => ("fmi2SetBoolean", (self.set_boolean)(self.component, reference, 1, &raw const whole)),
            }
        };
        checked(call, status)
    }

    fn enter_initialization(&mut self) -> Result<(), String> {
        // SAFETY: the component is an instance of this library.
        checked("fmi2SetupExperiment", unsafe { (self.setup)(self.component, 0, 0.0, 0.0, 0, 0.0) })?;
        // SAFETY: likewise.
        checked("fmi2EnterInitializationMode", unsafe { (self.enter)(self.component) })
    }

    fn exit_initialization(&mut self) -> Result<(), String> {
        // SAFETY: the component is an instance of this library.
        checked("fmi2ExitInitializationMode", unsafe { (self.exit)(self.component) })
    }

    fn step(&mut self, time_s: f64, step_s: f64) -> Result<(), String> {
        // SAFETY: the component is an initialized instance of this library.
        checked("fmi2DoStep", unsafe { (self.do_step)(self.component, time_s, step_s, 1) })
    }

    fn get(&mut self, wire: Wire) -> Result<f64, String> {
        let mut value = f64::NAN;
        // SAFETY: one reference, and room for one value.
        let status = unsafe { (self.get_real)(self.component, &raw const wire.reference, 1, &raw mut value) };
        checked("fmi2GetReal", status)?;
        Ok(value)
    }

    fn terminate(&mut self) {
        // SAFETY: the component is an initialized instance of this library.
        unsafe { (self.terminate)(self.component) };
    }

    fn free(&mut self) {
        // SAFETY: the component is an instance of this library, and used no more.
        unsafe { (self.free)(self.component) };
    }
}

/// Passes on what an FMU logs, to standard error. A message of FMI 2 may hold places for arguments, which stay as they are.
pub(super) fn told(status: Status, message: *const c_char) {
    if !message.is_null() {
        // SAFETY: a text of the standard ends in NUL, and is there until the call returns.
        let message = unsafe { CStr::from_ptr(message) }.to_string_lossy();
        // Whether anybody reads it is not the FMU's affair.
        let _ = writeln!(std::io::stderr(), "status {status}: {}", message.trim_end());
    }
}

/// A function of a library, which stays valid while that is open.
pub(super) fn function<F: Copy>(library: &Library, name: &CStr) -> Result<F, String> {
    // SAFETY: the standard says of each name what function it is; whoever asks keeps the library open.
    let found: Symbol<'_, F> = unsafe { library.get(name.to_bytes_with_nul()) }
        .map_err(|_| format!("its library has no function {}", name.to_string_lossy()))?;
    Ok(*found)
}

/// A path as it stands in an address.
fn percent_encoded(path: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-._~/".contains(&byte);
    let encode = |byte: u8| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    path.bytes().map(encode).collect()
}
