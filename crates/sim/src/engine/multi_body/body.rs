//! Parameter sets of multi-body vehicles. Values with one entry per axle list the front axle first.

use crate::scenario::BodyKind;

/// Parameters of a vehicle that is symmetrical about its longitudinal plane.
#[derive(Debug)]
pub(super) struct BodyParams {
    pub(super) mass_kg: f64,
    pub(super) sprung_kg: f64,
    pub(super) unsprung_kg: [f64; 2],
    /// Distances from the centre of gravity of the sprung mass to the axles.
    pub(super) axle_m: [f64; 2],
    pub(super) pitch_inertia_kgm2: f64,
    /// Stiffness of the suspension, per wheel.
    pub(super) spring_npm: [f64; 2],
    /// Damping of the suspension, per wheel.
    pub(super) damper_nspm: [f64; 2],
    /// Vertical stiffness of the tyres, per wheel.
    pub(super) tyre_spring_npm: [f64; 2],
    /// Height of the centre of gravity of the sprung mass.
    pub(super) cg_height_m: f64,
    pub(super) wheel_radius_m: f64,
    /// Moment of inertia, per wheel.
    pub(super) wheel_inertia_kgm2: [f64; 2],
    /// Share of the brake torque on the front axle.
    pub(super) brake_front_share: f64,
    /// Share of the engine torque on the front axle.
    pub(super) engine_front_share: f64,
    pub(super) tyre: TyreParams,
    pub(super) brake: BrakeParams,
}

/// Coefficients of Pacejka's formula for the longitudinal force, named as in the CommonRoad documentation.
#[derive(Debug)]
pub(super) struct TyreParams {
    pub(super) p_cx1: f64,
    pub(super) p_dx1: f64,
    pub(super) p_ex1: f64,
    pub(super) p_kx1: f64,
    pub(super) p_hx1: f64,
    pub(super) p_vx1: f64,
}

/// Response of the brake: dead time, then a first-order rise of the pressure.
#[derive(Debug)]
pub(super) struct BrakeParams {
    pub(super) delay_s: f64,
    pub(super) lag_s: f64,
}

const CAR_TYRE: TyreParams = TyreParams {
    p_cx1: 1.6411,
    p_dx1: 1.1739,
    p_ex1: 0.46403,
    p_kx1: 22.303,
    p_hx1: 0.001_229_7,
    p_vx1: -8.8098e-6,
};

/// Hydraulic brake with a booster or a pump: 90 % of the pressure after 0.28 s.
const HYDRAULIC_BRAKE: BrakeParams = BrakeParams {
    delay_s: 0.05,
    lag_s: 0.1,
};

/// Tyre of a lorry; the shape is that of the car's.
const LORRY_TYRE: TyreParams = TyreParams {
    p_cx1: 1.6411,
    p_dx1: 0.8,
    p_ex1: 0.46403,
    p_kx1: 15.0,
    p_hx1: 0.0,
    p_vx1: 0.0,
};

/// Air brake: 75 % of the pressure after 0.59 s, just within the limit of UN Regulation 13.
const AIR_BRAKE: BrakeParams = BrakeParams {
    delay_s: 0.2,
    lag_s: 0.28,
};

static FORD_ESCORT: BodyParams = BodyParams {
    mass_kg: 1_225.887_846_725_334_4,
    sprung_kg: 1_094.542_720_290_477,
    unsprung_kg: [65.672_563_217_428_63; 2],
    axle_m: [0.883_92, 1.508_76],
    pitch_inertia_kgm2: 1_342.259_768_848_086_4,
    spring_npm: [21_898.332_429_625_985; 2],
    damper_nspm: [1_459.390_293_720_636_2; 2],
    tyre_spring_npm: [189_785.547_723_425_2; 2],
    cg_height_m: 0.594_36,
    wheel_radius_m: 0.344,
    wheel_inertia_kgm2: [1.7; 2],
    brake_front_share: 0.76,
    engine_front_share: 1.0,
    tyre: CAR_TYRE,
    brake: HYDRAULIC_BRAKE,
};

static BMW_320I: BodyParams = BodyParams {
    mass_kg: 1_093.295_233_467_404_6,
    sprung_kg: 965.710_809_880_436_3,
    unsprung_kg: [63.792_182_605_678_4; 2],
    axle_m: [1.156_195_706_4, 1.422_717_093_6],
    pitch_inertia_kgm2: 1_565.817_878_712_554_1,
    spring_npm: [24_453.137_879_749_014, 19_635.504_745_231_297],
    damper_nspm: [1_786.244_100_244_072_3, 1_649.083_303_488_738_2],
    tyre_spring_npm: [158_294.139_811_911_5; 2],
    cg_height_m: 0.613_730_04,
    wheel_radius_m: 0.344,
    wheel_inertia_kgm2: [1.7; 2],
    brake_front_share: 0.66,
    engine_front_share: 0.0,
    tyre: CAR_TYRE,
    brake: HYDRAULIC_BRAKE,
};

static VW_VANAGON: BodyParams = BodyParams {
    mass_kg: 1_478.897_963_776_799_8,
    sprung_kg: 1_316.608_655_249_037_4,
    unsprung_kg: [81.144_289_416_307_96; 2],
    axle_m: [1.150_791_602_4, 1.321_136_397_600_000_1],
    pitch_inertia_kgm2: 2_204.322_715_845_899,
    spring_npm: [33_577.443_058_759_84, 39_125.020_607_598_424],
    damper_nspm: [2_405.564_099_800_005, 2_769.727_219_182_409],
    tyre_spring_npm: [212_641.567_224_640_17; 2],
    cg_height_m: 0.804_490_644,
    wheel_radius_m: 0.344,
    wheel_inertia_kgm2: [1.7; 2],
    brake_front_share: 0.64,
    engine_front_share: 0.0,
    tyre: CAR_TYRE,
    brake: HYDRAULIC_BRAKE,
};

/// Axle loads 5.5 t and 9.5 t. The pitch inertia is the sprung mass times the product of the axle distances.
static LORRY_LADEN: BodyParams = BodyParams {
    mass_kg: 15_000.0,
    sprung_kg: 13_420.0,
    axle_m: [3.152, 1.848],
    pitch_inertia_kgm2: 78_170.0,
    cg_height_m: 1.7,
    brake_front_share: 0.5,
    ..LORRY
};

/// Axle loads 3.9 t and 3.1 t.
static LORRY_UNLADEN: BodyParams = BodyParams {
    mass_kg: 7_000.0,
    sprung_kg: 5_420.0,
    axle_m: [1.9, 3.1],
    pitch_inertia_kgm2: 31_920.0,
    cg_height_m: 1.0,
    brake_front_share: 0.6,
    ..LORRY
};

/// Values of the lorry that do not depend on its load; the other fields are placeholders. Rear wheels are twin wheels.
const LORRY: BodyParams = BodyParams {
    mass_kg: f64::NAN,
    sprung_kg: f64::NAN,
    unsprung_kg: [540.0, 1040.0],
    axle_m: [f64::NAN; 2],
    pitch_inertia_kgm2: f64::NAN,
    spring_npm: [200e3, 500e3],
    damper_nspm: [9e3, 18e3],
    tyre_spring_npm: [800e3, 1600e3],
    cg_height_m: f64::NAN,
    wheel_radius_m: 0.5,
    wheel_inertia_kgm2: [10.0, 20.0],
    brake_front_share: f64::NAN,
    engine_front_share: 0.0,
    tyre: LORRY_TYRE,
    brake: AIR_BRAKE,
};

/// Returns the parameters of a vehicle.
pub(super) fn body_params(kind: BodyKind) -> &'static BodyParams {
    match kind {
        BodyKind::FordEscort => &FORD_ESCORT,
        BodyKind::Bmw320i => &BMW_320I,
        BodyKind::VwVanagon => &VW_VANAGON,
        BodyKind::LorryLaden => &LORRY_LADEN,
        BodyKind::LorryUnladen => &LORRY_UNLADEN,
    }
}
