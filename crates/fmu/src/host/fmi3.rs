//! Co-simulation calls of FMI 3.0 (chapters 2.3 and 4.2), without events and intermediate updates.

#![allow(unsafe_code)]

use std::ffi::{CString, c_char, c_int, c_uint, c_void};
use std::path::Path;
use std::ptr;

use libloading::Library;

use super::fmi2::{c_string, load_symbol, log_message};
use super::instance::{FmiFunctions, VariableRef, check_status, load_error_message};
use crate::{ModelDescription, VariableType};

type Fmi3Instance = *mut c_void;
type Fmi3Status = c_int;
type Fmi3Logger = extern "C" fn(*mut c_void, Fmi3Status, *const c_char, *const c_char);

extern "C" fn log(_: *mut c_void, status: Fmi3Status, _: *const c_char, message: *const c_char) {
    log_message(status, message);
}

type Fmi3Instantiate = unsafe extern "C" fn(
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
    Fmi3Logger,
    *const c_void,
) -> Fmi3Instance;
type Fmi3InstanceCall = unsafe extern "C" fn(Fmi3Instance) -> Fmi3Status;
type Fmi3FreeInstance = unsafe extern "C" fn(Fmi3Instance);
type Fmi3EnterInitializationMode =
    unsafe extern "C" fn(Fmi3Instance, bool, f64, f64, bool, f64) -> Fmi3Status;
type Fmi3DoStep = unsafe extern "C" fn(
    Fmi3Instance,
    f64,
    f64,
    bool,
    *mut bool,
    *mut bool,
    *mut bool,
    *mut f64,
) -> Fmi3Status;
type Fmi3SetFloat64 =
    unsafe extern "C" fn(Fmi3Instance, *const c_uint, usize, *const f64, usize) -> Fmi3Status;
type Fmi3SetInt32 =
    unsafe extern "C" fn(Fmi3Instance, *const c_uint, usize, *const i32, usize) -> Fmi3Status;
type Fmi3SetBoolean =
    unsafe extern "C" fn(Fmi3Instance, *const c_uint, usize, *const bool, usize) -> Fmi3Status;
type Fmi3GetFloat64 =
    unsafe extern "C" fn(Fmi3Instance, *const c_uint, usize, *mut f64, usize) -> Fmi3Status;

pub(super) struct Fmi3 {
    instantiate: Fmi3Instantiate,
    free: Fmi3FreeInstance,
    reset: Fmi3InstanceCall,
    enter_initialization_mode: Fmi3EnterInitializationMode,
    exit_initialization_mode: Fmi3InstanceCall,
    terminate: Fmi3InstanceCall,
    do_step: Fmi3DoStep,
    set_float64: Fmi3SetFloat64,
    set_int32: Fmi3SetInt32,
    set_boolean: Fmi3SetBoolean,
    get_float64: Fmi3GetFloat64,
    token: CString,
    resources: CString,
    instance: Fmi3Instance,
    /// Dropped last, because the functions above belong to it.
    _library: Library,
}

impl Fmi3 {
    pub(super) fn load(
        library: &Path,
        folder: &Path,
        description: &ModelDescription,
    ) -> Result<Self, String> {
        // The standard requires a separator at the end.
        let location = folder
            .join("resources")
            .join("")
            .to_string_lossy()
            .into_owned();
        // SAFETY: loading runs the library's initializers. Code of the FMU may run here: this process exists to run it.
        let library =
            unsafe { Library::new(library) }.map_err(|error| load_error_message(&error, folder))?;
        Ok(Self {
            instantiate: load_symbol(&library, c"fmi3InstantiateCoSimulation")?,
            free: load_symbol(&library, c"fmi3FreeInstance")?,
            reset: load_symbol(&library, c"fmi3Reset")?,
            enter_initialization_mode: load_symbol(&library, c"fmi3EnterInitializationMode")?,
            exit_initialization_mode: load_symbol(&library, c"fmi3ExitInitializationMode")?,
            terminate: load_symbol(&library, c"fmi3Terminate")?,
            do_step: load_symbol(&library, c"fmi3DoStep")?,
            set_float64: load_symbol(&library, c"fmi3SetFloat64")?,
            set_int32: load_symbol(&library, c"fmi3SetInt32")?,
            set_boolean: load_symbol(&library, c"fmi3SetBoolean")?,
            get_float64: load_symbol(&library, c"fmi3GetFloat64")?,
            token: c_string(&description.instantiation_token)?,
            resources: c_string(&location)?,
            instance: ptr::null_mut(),
            _library: library,
        })
    }
}

impl FmiFunctions for Fmi3 {
    fn instantiate(&mut self) -> Result<(), String> {
        let no_variables = ptr::null();
        let environment = ptr::null_mut();
        // SAFETY: the texts end in NUL and live as long as the instance; no variables need intermediate updates.
        self.instance = unsafe {
            (self.instantiate)(
                c"crumple".as_ptr(),
                self.token.as_ptr(),
                self.resources.as_ptr(),
                false,
                false,
                false,
                false,
                no_variables,
                0,
                environment,
                log,
                ptr::null(),
            )
        };
        if self.instance.is_null() {
            return Err("the FMU cannot be instantiated (fmi3InstantiateCoSimulation)".to_owned());
        }
        Ok(())
    }

    fn reset(&mut self) -> Result<(), String> {
        // SAFETY: an instance of this library.
        check_status("fmi3Reset", unsafe { (self.reset)(self.instance) })
    }

    fn set(&mut self, variable: VariableRef, value: f64) -> Result<(), String> {
        let instance = self.instance;
        let reference = &raw const variable.value_reference;
        let whole = value as i32;
        let truth = value != 0.0;
        // SAFETY: the call reads one reference and one value; both live until it returns.
        let status = unsafe {
            match variable.kind {
                VariableType::Real => {
                    (self.set_float64)(instance, reference, 1, &raw const value, 1)
                }
                VariableType::Integer => {
                    (self.set_int32)(instance, reference, 1, &raw const whole, 1)
                }
                VariableType::Boolean => {
                    (self.set_boolean)(instance, reference, 1, &raw const truth, 1)
                }
            }
        };
        let call = match variable.kind {
            VariableType::Real => "fmi3SetFloat64",
            VariableType::Integer => "fmi3SetInt32",
            VariableType::Boolean => "fmi3SetBoolean",
        };
        check_status(call, status)
    }

    fn enter_initialization(&mut self) -> Result<(), String> {
        // SAFETY: an instance of this library.
        check_status("fmi3EnterInitializationMode", unsafe {
            (self.enter_initialization_mode)(self.instance, false, 0.0, 0.0, false, 0.0)
        })
    }

    fn exit_initialization(&mut self) -> Result<(), String> {
        // SAFETY: an instance of this library.
        check_status("fmi3ExitInitializationMode", unsafe {
            (self.exit_initialization_mode)(self.instance)
        })
    }

    fn step(&mut self, time_s: f64, step_s: f64) -> Result<(), String> {
        let mut event = false;
        let mut ends = false;
        let mut early = false;
        let mut last_s = time_s + step_s;
        // SAFETY: an initialized instance of this library, and room for all results of the step.
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
        check_status("fmi3DoStep", status)?;
        if ends {
            Err(format!(
                "the FMU requested the end of the simulation at {last_s} s"
            ))
        } else {
            Ok(())
        }
    }

    fn get(&mut self, variable: VariableRef) -> Result<f64, String> {
        let mut value = f64::NAN;
        // SAFETY: one reference, and room for one value.
        let status = unsafe {
            (self.get_float64)(
                self.instance,
                &raw const variable.value_reference,
                1,
                &raw mut value,
                1,
            )
        };
        check_status("fmi3GetFloat64", status)?;
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
