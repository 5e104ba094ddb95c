//! Plants: models of the dynamics between a controller's demand and the motion of a vehicle.

use serde::{Deserialize, Serialize};

use super::{Driver, InvalidField, Scenario, VehicleClass};

/// Plant of a vehicle that a controller drives.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum PlantKind {
    /// Point mass with an ideal brake: the acceleration equals the demand within the limits of the vehicle.
    #[default]
    PointMass,
    /// Body with suspension, wheels, tyres, brake pressure and an anti-lock braking system.
    MultiBody,
}

impl PlantKind {
    /// Returns the name in files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::PointMass => "point-mass",
            Self::MultiBody => "multi-body",
        }
    }
}

/// Parameter set of a multi-body vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum BodyKind {
    /// Ford Escort, vehicle 1 of CommonRoad.
    FordEscort,
    /// BMW 320i, vehicle 2 of CommonRoad.
    #[serde(rename = "bmw-320i")]
    Bmw320i,
    /// VW Vanagon, vehicle 3 of CommonRoad.
    VwVanagon,
    /// Two-axle lorry of 15 t with load.
    LorryLaden,
    /// Two-axle lorry of 7 t without load.
    LorryUnladen,
}

impl BodyKind {
    /// All parameter sets.
    pub const ALL: [Self; 5] = [
        Self::FordEscort,
        Self::Bmw320i,
        Self::VwVanagon,
        Self::LorryLaden,
        Self::LorryUnladen,
    ];

    /// Returns the parameter set of a class: `bmw-320i` for `light`, `lorry-laden` for `heavy`.
    #[must_use]
    pub fn from_class(class: VehicleClass) -> Self {
        match class {
            VehicleClass::Light => Self::Bmw320i,
            VehicleClass::Heavy => Self::LorryLaden,
        }
    }
}

impl Scenario {
    /// Returns the scenario with a plant for all vehicles that a controller drives. Scripted vehicles do not change.
    ///
    /// # Errors
    /// [`InvalidField`] in principle, if the changed scenario is invalid.
    pub fn with_plant(&self, plant: PlantKind) -> Result<Self, InvalidField> {
        self.edited(|spec| {
            for vehicle in spec
                .vehicles
                .iter_mut()
                .filter(|vehicle| !matches!(vehicle.driver, Driver::Profile(_)))
            {
                vehicle.plant = plant;
                if plant == PlantKind::PointMass {
                    vehicle.body = None;
                }
            }
        })
    }
}
