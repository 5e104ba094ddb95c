//! Co-simulation calls of FMI 2.0 (chapters 2.1 and 4.2).

#![allow(unsafe_code)]

use std::ffi::{CStr, CString, c_char, c_int, c_uint, c_void};
use std::io::Write as _;
use std::path::Path;
use std::ptr;

use libloading::{Library, Symbol};

use super::instance::{FmiFunctions, VariableRef, check_status, load_error_message};
use crate::{ModelDescription, VariableType};

type Fmi2Component = *mut c_void;
type Fmi2Status = c_int;
type Fmi2Logger =
    extern "C" fn(*mut c_void, *const c_char, Fmi2Status, *const c_char, *const c_char);

unsafe extern "C" {
    fn calloc(count: usize, size: usize) -> *mut c_void;
    fn free(memory: *mut c_void);
}

#[repr(C)]
struct Fmi2Callbacks {
    logger: Fmi2Logger,
    allocate_memory: unsafe extern "C" fn(usize, usize) -> *mut c_void,
    free_memory: unsafe extern "C" fn(*mut c_void),
    step_finished: *const c_void,
    environment: *mut c_void,
}

/// The standard declares a variadic logger. By the C conventions of x86-64 and AArch64, a function that ignores the
/// variadic arguments can be called the same way.
extern "C" fn log(
    _: *mut c_void,
    _: *const c_char,
    status: Fmi2Status,
    _: *const c_char,
    message: *const c_char,
) {
    log_message(status, message);
}

type Fmi2Instantiate = unsafe extern "C" fn(
    *const c_char,
    c_int,
    *const c_char,
    *const c_char,
    *const Fmi2Callbacks,
    c_int,
    c_int,
) -> Fmi2Component;
type Fmi2ComponentCall = unsafe extern "C" fn(Fmi2Component) -> Fmi2Status;
type Fmi2FreeInstance = unsafe extern "C" fn(Fmi2Component);
type Fmi2SetupExperiment =
    unsafe extern "C" fn(Fmi2Component, c_int, f64, f64, c_int, f64) -> Fmi2Status;
type Fmi2DoStep = unsafe extern "C" fn(Fmi2Component, f64, f64, c_int) -> Fmi2Status;
type Fmi2SetReal =
    unsafe extern "C" fn(Fmi2Component, *const c_uint, usize, *const f64) -> Fmi2Status;
type Fmi2SetInteger =
    unsafe extern "C" fn(Fmi2Component, *const c_uint, usize, *const c_int) -> Fmi2Status;
type Fmi2GetReal =
    unsafe extern "C" fn(Fmi2Component, *const c_uint, usize, *mut f64) -> Fmi2Status;

pub(super) struct Fmi2 {
    instantiate: Fmi2Instantiate,
    free: Fmi2FreeInstance,
    reset: Fmi2ComponentCall,
    setup_experiment: Fmi2SetupExperiment,
    enter_initialization_mode: Fmi2ComponentCall,
    exit_initialization_mode: Fmi2ComponentCall,
    terminate: Fmi2ComponentCall,
    do_step: Fmi2DoStep,
    set_real: Fmi2SetReal,
    set_integer: Fmi2SetInteger,
    set_boolean: Fmi2SetInteger,
    get_real: Fmi2GetReal,
    token: CString,
    resources: CString,
    callbacks: Box<Fmi2Callbacks>,
    component: Fmi2Component,
    /// Dropped last, because the functions above belong to it.
    _library: Library,
}

impl Fmi2 {
    pub(super) fn load(
        library: &Path,
        folder: &Path,
        description: &ModelDescription,
    ) -> Result<Self, String> {
        let location = format!(
            "file://{}",
            percent_encode(&folder.join("resources").to_string_lossy())
        );
        // SAFETY: loading runs the library's initializers. Code of the FMU may run here: this process exists to run it.
        let library =
            unsafe { Library::new(library) }.map_err(|error| load_error_message(&error, folder))?;
        Ok(Self {
            instantiate: load_symbol(&library, c"fmi2Instantiate")?,
            free: load_symbol(&library, c"fmi2FreeInstance")?,
            reset: load_symbol(&library, c"fmi2Reset")?,
            setup_experiment: load_symbol(&library, c"fmi2SetupExperiment")?,
            enter_initialization_mode: load_symbol(&library, c"fmi2EnterInitializationMode")?,
            exit_initialization_mode: load_symbol(&library, c"fmi2ExitInitializationMode")?,
            terminate: load_symbol(&library, c"fmi2Terminate")?,
            do_step: load_symbol(&library, c"fmi2DoStep")?,
            set_real: load_symbol(&library, c"fmi2SetReal")?,
            set_integer: load_symbol(&library, c"fmi2SetInteger")?,
            set_boolean: load_symbol(&library, c"fmi2SetBoolean")?,
            get_real: load_symbol(&library, c"fmi2GetReal")?,
            token: c_string(&description.instantiation_token)?,
            resources: c_string(&location)?,
            callbacks: Box::new(Fmi2Callbacks {
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

impl FmiFunctions for Fmi2 {
    fn instantiate(&mut self) -> Result<(), String> {
        const CO_SIMULATION: c_int = 1;
        // SAFETY: the texts end in NUL; they and the callbacks live as long as the instance, and do not move.
        self.component = unsafe {
            (self.instantiate)(
                c"crumple".as_ptr(),
                CO_SIMULATION,
                self.token.as_ptr(),
                self.resources.as_ptr(),
                &raw const *self.callbacks,
                0,
                0,
            )
        };
        if self.component.is_null() {
            return Err("the FMU cannot be instantiated (fmi2Instantiate)".to_owned());
        }
        Ok(())
    }

    fn reset(&mut self) -> Result<(), String> {
        // SAFETY: the component is an instance of this library.
        check_status("fmi2Reset", unsafe { (self.reset)(self.component) })
    }

    fn set(&mut self, variable: VariableRef, value: f64) -> Result<(), String> {
        let component = self.component;
        let reference = &raw const variable.value_reference;
        let whole = value as c_int;
        // SAFETY: the call reads one reference and one value; both live until it returns.
        let status = unsafe {
            match variable.kind {
                VariableType::Real => (self.set_real)(component, reference, 1, &raw const value),
                VariableType::Integer => {
                    (self.set_integer)(component, reference, 1, &raw const whole)
                }
                VariableType::Boolean => {
                    (self.set_boolean)(component, reference, 1, &raw const whole)
                }
            }
        };
        let call = match variable.kind {
            VariableType::Real => "fmi2SetReal",
            VariableType::Integer => "fmi2SetInteger",
            VariableType::Boolean => "fmi2SetBoolean",
        };
        check_status(call, status)
    }

    fn enter_initialization(&mut self) -> Result<(), String> {
        // SAFETY: the component is an instance of this library.
        check_status("fmi2SetupExperiment", unsafe {
            (self.setup_experiment)(self.component, 0, 0.0, 0.0, 0, 0.0)
        })?;
        // SAFETY: likewise.
        check_status("fmi2EnterInitializationMode", unsafe {
            (self.enter_initialization_mode)(self.component)
        })
    }

    fn exit_initialization(&mut self) -> Result<(), String> {
        // SAFETY: the component is an instance of this library.
        check_status("fmi2ExitInitializationMode", unsafe {
            (self.exit_initialization_mode)(self.component)
        })
    }

    fn step(&mut self, time_s: f64, step_s: f64) -> Result<(), String> {
        // SAFETY: the component is an initialized instance of this library.
        check_status("fmi2DoStep", unsafe {
            (self.do_step)(self.component, time_s, step_s, 1)
        })
    }

    fn get(&mut self, variable: VariableRef) -> Result<f64, String> {
        let mut value = f64::NAN;
        // SAFETY: one reference, and room for one value.
        let status = unsafe {
            (self.get_real)(
                self.component,
                &raw const variable.value_reference,
                1,
                &raw mut value,
            )
        };
        check_status("fmi2GetReal", status)?;
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

/// Writes a log message of an FMU to standard error. `printf` placeholders of FMI 2 are not replaced.
pub(super) fn log_message(status: Fmi2Status, message: *const c_char) {
    if !message.is_null() {
        // SAFETY: a text of the standard ends in NUL, and is there until the call returns.
        let message = unsafe { CStr::from_ptr(message) }.to_string_lossy();
        // A closed standard error must not affect the FMU.
        let _ = std::io::stderr()
            .write_all(format!("status {status}: {}\n", message.trim_end()).as_bytes());
    }
}

/// Returns a function of a library, which must stay open while the function is used.
pub(super) fn load_symbol<F: Copy>(library: &Library, name: &CStr) -> Result<F, String> {
    // SAFETY: the standard defines the signature of each name, and the caller keeps the library open.
    let symbol: Symbol<'_, F> = unsafe { library.get(name.to_bytes_with_nul()) }
        .map_err(|_| format!("its library has no function {}", name.to_string_lossy()))?;
    Ok(*symbol)
}

/// Returns a text that ends in NUL.
pub(super) fn c_string(text: &str) -> Result<CString, String> {
    CString::new(text).map_err(|_| format!("{text:?} contains a NUL character"))
}

fn percent_encode(path: &str) -> String {
    path.bytes()
        .map(|byte| match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b'~' | b'/' => {
                char::from(byte).to_string()
            }
            _ => format!("%{byte:02X}"),
        })
        .collect()
}
