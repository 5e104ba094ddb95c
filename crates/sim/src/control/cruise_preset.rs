//! Adaptive cruise controls of production cars: settings of `idm` and `acc-aeb` under a name.
//!
//! Source: recordings of OpenACC's ZalaZONE campaign, October 2019 (Joint Research Centre, doi:10.2905/JRC.KMH3D00),
//! to which the experiment `openacc` fits the settings; `reports/openacc.md` has the errors. Each car has a short and
//! a long distance setting. The recordings have no emergencies, so a model says nothing about the emergency brake of
//! its car.

use super::{AccAebSettings, BuiltInController, ControllerPreset, FIRING_TTC_S, IdmSettings};

/// Conditions of the recordings with which the models were compared.
const CRUISE_DOMAIN: Option<&str> = Some(
    "compared with recordings of following on one track at up to 35 m/s, without emergencies, cut-ins or rain; other \
     results are extrapolations",
);

/// Returns `idm` with a desired speed (m/s), time headway (s), standstill gap (m), acceleration and braking (m/s²).
const fn idm(settings: [f64; 5]) -> BuiltInController {
    let [
        desired_speed_mps,
        time_headway_s,
        standstill_gap_m,
        accel_mps2,
        comfortable_brake_mps2,
    ] = settings;
    BuiltInController::Idm(IdmSettings {
        desired_speed_mps,
        time_headway_s,
        standstill_gap_m,
        accel_mps2,
        comfortable_brake_mps2,
    })
}

/// Returns `acc-aeb` with a time headway (s), standstill gap (m), gains of gap (1/s²) and speed (1/s), braking and
/// acceleration (m/s²), and set speed (m/s). Its emergency brake keeps the default.
const fn acc(settings: [f64; 7]) -> BuiltInController {
    let [
        time_headway_s,
        standstill_gap_m,
        gap_gain_per_s2,
        speed_gain_per_s,
        comfort_brake_mps2,
        comfort_accel_mps2,
        set_speed_mps,
    ] = settings;
    BuiltInController::AccAeb(AccAebSettings {
        ttc_s: FIRING_TTC_S,
        time_headway_s,
        standstill_gap_m,
        gap_gain_per_s2,
        speed_gain_per_s,
        comfort_brake_mps2,
        comfort_accel_mps2,
        set_speed_mps,
    })
}

/// All models, as the files in `examples/controllers/openacc` have them.
pub static CRUISE_PRESETS: [ControllerPreset; 20] = [
    ControllerPreset {
        name: "cruise:audi-a4-long",
        summary: "Audi A4, long distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: idm([33.923, 2.538, 4.673, 1.28, 4.0]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:audi-a4-short",
        summary: "Audi A4, short distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: idm([33.923, 1.603, 4.673, 1.28, 4.0]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:audi-e-tron-long",
        summary: "Audi e-tron, long distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: acc([2.56, 9.963, 0.081, 0.837, 4.735, 1.661, 41.559]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:audi-e-tron-short",
        summary: "Audi e-tron, short distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: acc([0.334, 9.963, 0.081, 0.837, 4.735, 1.661, 41.559]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:bmw-i3-long",
        summary: "BMW i3, long distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: idm([27.572, 2.486, 1.119, 1.011, 2.71]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:bmw-i3-short",
        summary: "BMW i3, short distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: idm([27.572, 1.372, 1.119, 1.011, 2.71]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:jaguar-i-pace-long",
        summary: "Jaguar I-Pace, long distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: acc([1.314, 10.0, 0.127, 1.17, 4.21, 1.013, 29.336]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:jaguar-i-pace-short",
        summary: "Jaguar I-Pace, short distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: acc([0.41, 10.0, 0.127, 1.17, 4.21, 1.013, 29.336]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:mazda-3-long",
        summary: "Mazda 3, long distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: idm([32.442, 1.747, 8.6, 1.773, 4.0]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:mazda-3-short",
        summary: "Mazda 3, short distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: idm([32.442, 1.026, 8.6, 1.773, 4.0]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:mercedes-gle450-long",
        summary: "Mercedes GLE 450, long distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: idm([26.847, 1.741, 3.865, 1.435, 3.976]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:mercedes-gle450-short",
        summary: "Mercedes GLE 450, short distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: idm([26.847, 1.084, 3.865, 1.435, 3.976]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:tesla-model3-long",
        summary: "Tesla Model 3, long distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: acc([2.339, 3.463, 0.466, 0.137, 3.657, 1.417, 17.952]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:tesla-model3-short",
        summary: "Tesla Model 3, short distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: acc([1.472, 3.463, 0.466, 0.137, 3.657, 1.417, 17.952]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:tesla-models-long",
        summary: "Tesla Model S, long distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: idm([22.178, 2.949, 0.513, 0.815, 0.196]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:tesla-models-short",
        summary: "Tesla Model S, short distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: idm([22.178, 1.458, 0.513, 0.815, 0.196]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:tesla-modelx-long",
        summary: "Tesla Model X, long distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: idm([45.0, 1.709, 3.633, 1.345, 3.145]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:tesla-modelx-short",
        summary: "Tesla Model X, short distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: idm([45.0, 0.926, 3.633, 1.345, 3.145]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:toyota-rav4-long",
        summary: "Toyota RAV4, long distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: idm([45.0, 1.69, 6.91, 1.337, 4.0]),
        domain: CRUISE_DOMAIN,
    },
    ControllerPreset {
        name: "cruise:toyota-rav4-short",
        summary: "Toyota RAV4, short distance: cruise control fitted to recordings of 2019 (OpenACC)",
        controller: idm([45.0, 0.935, 6.91, 1.337, 4.0]),
        domain: CRUISE_DOMAIN,
    },
];
