//! The calls of FMI 3.0 (chapters 2.3 and 4.2), for co-simulation without events or intermediate updates.

#![allow(unsafe_code)]

use std::ffi::{CString, c_char, c_int, c_uint, c_void};
use std::ptr;

use libloading::Library;

use super::fmi2::{function, told};
use super::instance::{Calls, Made, Wire, checked, not_loaded, resources};
use crate::Kind;

type Handle = *mut c_void;
type Status = c_int;
type Logger = extern "C" fn(*mut c_void, Status, *const c_char, *const c_char);

extern "C" fn log(_: *mut c_void, status: Status, _: *const c_char, message: *const c_char) {
    told(status, message);
}

type Instantiate = unsafe extern "C" fn(
    *const c_char,
    *const c_char,
    *const c_char,
    bool,
    bool,
    bool,
    bool,
    *const c_uint,
    usize,
    *mut c_void,
    Logger,
    *const c_void,
) -> Handle;
type OfInstance = unsafe extern "C" fn(Handle) -> Status;
type Free = unsafe extern "C" fn(Handle);
type Enter = unsafe extern "C" fn(Handle, bool, f64, f64, bool, f64) -> Status;
type DoStep = unsafe extern "C" fn(Handle, f64, f64, bool, *mut bool, *mut bool, *mut bool, *mut f64) -> Status;
type SetFloat64 = unsafe extern "C" fn(Handle, *const c_uint, usize, *const f64, usize) -> Status;
type SetInt32 = unsafe extern "C" fn(Handle, *const c_uint, usize, *const i32, usize) -> Status;
type SetBoolean = unsafe extern "C" fn(Handle, *const c_uint, usize, *const bool, usize) -> Status;
type GetFloat64 = unsafe extern "C" fn(Handle, *const c_uint, usize, *mut f64, usize) -> Status;

/// An FMU of FMI 3.0.
pub(super) struct Fmi3 {
    instantiate: Instantiate,
    free: Free,
    reset: OfInstance,
    enter: Enter,
    exit: OfInstance,
    terminate: OfInstance,
    do_step: DoStep,
    set_float64: SetFloat64,
    set_int32: SetInt32,
    set_boolean: SetBoolean,
    get_float64: GetFloat64,
    token: CString,
    resources: CString,
    instance: Handle,
    /// The functions above are its own: it is closed after all of them.
    _library: Library,
}

impl Fmi3 {
    pub(super) fn load(made: &Made<'_>) -> Result<Self, String> {
        let text = |text: &str| CString::new(text).map_err(|_| format!("{text:?} holds a NUL"));
        // With a separator at its end, as the standard wants it.
        let location = resources(made.folder).join("").to_string_lossy().into_owned();
        // SAFETY: loading runs the library's initializers, which is what this process is for.
        let library = unsafe { Library::new(made.library) }.map_err(|error| not_loaded(&error, made.folder))?;
        Ok(Self {
            instantiate: function(&library, c"fmi3InstantiateCoSimulation")?,
            free: function(&library, c"fmi3FreeInstance")?,
            reset: function(&library, c"fmi3Reset")?,
            enter: function(&library, c"fmi3EnterInitializationMode")?,
            exit: function(&library, c"fmi3ExitInitializationMode")?,
            terminate: function(&library, c"fmi3Terminate")?,
            do_step: function(&library, c"fmi3DoStep")?,
            set_float64: function(&library, c"fmi3SetFloat64")?,
            set_int32: function(&library, c"fmi3SetInt32")?,
            set_boolean: function(&library, c"fmi3SetBoolean")?,
            get_float64: function(&library, c"fmi3GetFloat64")?,
            token: text(&made.description.token)?,
            resources: text(&location)?,
            instance: ptr::null_mut(),
            _library: library,
        })
    }
}

impl Calls for Fmi3 {
    fn instantiate(&mut self) -> Result<(), String> {
        let (token, resources) = (self.token.as_ptr(), self.resources.as_ptr());
        let (none, nobody) = (ptr::null(), ptr::null_mut());
        // SAFETY: the texts end in NUL and live as long as the instance; no variables need intermediate updates.
        self.instance = unsafe {
            (self.instantiate)(
                c"crumple".as_ptr(),
                token,
                resources,
                false,
                false,
                false,
                false,
                none,
                0,
                nobody,
                log,
                ptr::null(),
            )
        };
        let problem = || "the FMU gives no instance (fmi3InstantiateCoSimulation)".to_owned();
        if self.instance.is_null() { Err(problem()) } else { Ok(()) }
    }

    fn reset(&mut self) -> Result<(), String> {
        // SAFETY: an instance of this library.
        checked("fmi3Reset", unsafe { (self.reset)(self.instance) })
    }

    fn set(&mut self, wire: Wire, value: f64) -> Result<(), String> {
        let reference = &raw const wire.reference;
        let (whole, truth) = (value as i32, value != 0.0);
        // SAFETY: one reference, and one value, which are read before the call returns.
        let (call, status) = unsafe {
            match wire.kind {
                Kind::Real => ("fmi3SetFloat64", (self.set_float64)(self.instance, reference, 1, &raw const value, 1)),
                Kind::Integer => ("fmi3SetInt32", (self.set_int32)(self.instance, reference, 1, &raw const whole, 1)),
                Kind::Boolean => {
                    ("fmi3SetBoolean", (self.set_boolean)(self.instance, reference, 1, &raw const truth, 1))
                }
            }
        };
        checked(call, status)
    }

    fn enter_initialization(&mut self) -> Result<(), String> {
        // SAFETY: an instance of this library.
        checked("fmi3EnterInitializationMode", unsafe { (self.enter)(self.instance, false, 0.0, 0.0, false, 0.0) })
    }

    fn exit_initialization(&mut self) -> Result<(), String> {
        // SAFETY: an instance of this library.
        checked("fmi3ExitInitializationMode", unsafe { (self.exit)(self.instance) })
    }

    fn step(&mut self, time_s: f64, step_s: f64) -> Result<(), String> {
        let (mut event, mut ends, mut early, mut last_s) = (false, false, false, time_s + step_s);
        // SAFETY: an initialized instance of this library, and room for what it says of the step.
        let status = unsafe {
            (self.do_step)(
                self.instance,
                time_s,
                step_s,
                true,
                &raw mut event,
                &raw mut ends,
                &raw mut early,
                &raw mut last_s,
            )
        };
        checked("fmi3DoStep", status)?;
        if ends { Err(format!("the FMU asks for the end of the simulation at {last_s} s")) } else { Ok(()) }
    }

    fn get(&mut self, wire: Wire) -> Result<f64, String> {
        let mut value = f64::NAN;
        // SAFETY: one reference, and room for one value.
        let status = unsafe { (self.get_float64)(self.instance, &raw const wire.reference, 1, &raw mut value, 1) };
        checked("fmi3GetFloat64", status)?;
        Ok(value)
    }

    fn terminate(&mut self) {
        // SAFETY: an instance of this library that has been initialized.
        unsafe { (self.terminate)(self.instance) };
    }

    fn free(&mut self) {
        // SAFETY: an instance of this library that is used no more.
        unsafe { (self.free)(self.instance) };
    }
}
