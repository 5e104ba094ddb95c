//! Settings of a controller as coordinates of a unit cube.

use super::TuneError;
use crumple_search::falsify::{EmptyBlock, UnitCube};
use crumple_sim::control::{BuiltInController, SettingField};

/// A setting to search, by name, and its range; none for the typical one.
#[derive(Debug, Clone, PartialEq)]
pub struct SettingRequest {
    /// Name of the setting, with its unit.
    pub name: String,
    /// Minimum and maximum, in the unit of the setting.
    pub range: Option<[f64; 2]>,
}

/// One setting to search.
#[derive(Debug, Clone, PartialEq)]
pub struct SearchedSetting {
    /// Description of the setting.
    pub field: &'static SettingField,
    /// Minimum and maximum of the search, in the unit of the setting.
    pub range: [f64; 2],
    index: usize,
    initial: f64,
}

impl SearchedSetting {
    /// Sets a value outside the range to the middle of it.
    fn move_into_range(&self, controller: &mut BuiltInController) {
        let [low, high] = self.range;
        if let Some(value) = controller
            .get_mut(self.index)
            .filter(|value| !(low..=high).contains(&**value))
        {
            *value = self.value(0.5);
        }
    }

    /// Returns the value at a coordinate in [0, 1], in the unit of the setting.
    ///
    /// Search methods start at 0.5, which is the initial value unless that is outside the range. Values are rounded to
    /// a thousandth of the range or less, so that results can be written as short text.
    fn value(&self, coordinate: f64) -> f64 {
        let [low, high] = self.range;
        let middle = if low < self.initial && self.initial < high {
            self.initial
        } else {
            0.5 * (low + high)
        };
        let value = match coordinate {
            ..0.5 => low + 2.0 * coordinate * (middle - low),
            _ => middle + (2.0 * coordinate - 1.0) * (high - middle),
        };
        let decimals = (3.0 - libm::log10(high - low).floor()).clamp(0.0, 12.0) as usize;
        format!("{value:.decimals$}")
            .parse()
            .unwrap_or(value)
            .clamp(low, high)
            + 0.0 // Turns -0 into 0.
    }
}

/// The settings to search, and the values of the others.
///
/// ```
/// use crumple_learn::tune::SettingSearch;
///
/// let search = SettingSearch::parse("acc-aeb,time_headway_s=1.5", &[]).unwrap();
/// assert_eq!(search.initial().to_arg(), "acc-aeb,time_headway_s=1.5");
/// assert!(search.searched().iter().all(|setting| setting.field.name != "time_headway_s"));
/// assert!(SettingSearch::parse("policy", &[]).is_err());
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct SettingSearch {
    initial: BuiltInController,
    searched: Vec<SearchedSetting>,
}

impl SettingSearch {
    /// Parses a controller as [`BuiltInController::parse`] does. The settings in the text are fixed. Searches the
    /// requested settings, or all others if `requests` is empty.
    ///
    /// # Errors
    /// [`TuneError`] for a controller that is not built in or has no settings, or an invalid setting or range.
    pub fn parse(controller: &str, requests: &[SettingRequest]) -> Result<Self, TuneError> {
        let mut initial = BuiltInController::parse(controller)
            .ok_or_else(|| TuneError::NotBuiltIn(controller.to_owned()))??;
        if initial.fields().is_empty() {
            return Err(TuneError::NoSettings(initial.name()));
        }
        let fixed: Vec<&str> = controller
            .split(',')
            .skip(1)
            .filter_map(|word| word.split('=').next())
            .collect();
        let mut searched = Vec::new();
        for (index, (field, value)) in initial.values().enumerate() {
            let is_fixed = fixed.contains(&field.name);
            let requested = find_request(field, requests, is_fixed)?;
            let range = requested
                .and_then(|request| request.range)
                .unwrap_or(field.typical_range);
            check_range(field, range)?;
            if !is_fixed && (requests.is_empty() || requested.is_some()) {
                searched.push(SearchedSetting {
                    field,
                    range,
                    index,
                    initial: value,
                });
            }
        }
        check_names(&initial, requests)?;
        if searched.is_empty() {
            return Err(TuneError::AllFixed(controller.to_owned()));
        }
        for setting in &searched {
            setting.move_into_range(&mut initial);
        }
        Ok(Self { initial, searched })
    }

    /// Returns the controller with the initial settings: those that are fixed, and the defaults, or the middle of the
    /// requested range if it excludes the default.
    #[must_use]
    pub fn initial(&self) -> &BuiltInController {
        &self.initial
    }

    /// Returns the settings to search, in the order of the controller; at least one.
    #[must_use]
    pub fn searched(&self) -> &[SearchedSetting] {
        &self.searched
    }

    /// Returns the range of a setting, if it is searched.
    pub(super) fn searched_range(&self, field: &SettingField) -> Option<[f64; 2]> {
        self.searched
            .iter()
            .find(|setting| setting.field.name == field.name)
            .map(|setting| setting.range)
    }

    pub(super) fn cube(&self) -> Result<UnitCube, TuneError> {
        UnitCube::new(self.searched.iter().map(|_| 1))
            .map_err(|EmptyBlock| TuneError::AllFixed(self.initial.to_arg()))
    }

    /// Returns the controller at a point of the cube.
    pub(super) fn controller_at(&self, point: &[f64]) -> BuiltInController {
        let mut controller = self.initial.clone();
        for (setting, &coordinate) in self.searched.iter().zip(point) {
            if let Some(value) = controller.get_mut(setting.index) {
                *value = setting.value(coordinate);
            }
        }
        controller
    }
}

/// Returns the request of a setting, if any. A setting can be requested once, unless it is fixed.
fn find_request<'a>(
    field: &SettingField,
    requests: &'a [SettingRequest],
    is_fixed: bool,
) -> Result<Option<&'a SettingRequest>, TuneError> {
    let mut requested = requests.iter().filter(|request| request.name == field.name);
    let request = requested.next();
    if requested.next().is_some() {
        return Err(setting_error(field.name, "is requested twice".to_owned()));
    }
    if is_fixed && request.is_some() {
        return Err(setting_error(
            field.name,
            "is fixed in the controller, and requested".to_owned(),
        ));
    }
    Ok(request)
}

fn check_range(field: &SettingField, [low, high]: [f64; 2]) -> Result<(), TuneError> {
    let [least, most] = field.range;
    if least <= low && low < high && high <= most {
        Ok(())
    } else {
        Err(setting_error(
            field.name,
            format!("a range must be LOW..HIGH, with LOW below HIGH, in {least}..{most}"),
        ))
    }
}

/// Checks that all requested settings exist.
fn check_names(
    controller: &BuiltInController,
    requests: &[SettingRequest],
) -> Result<(), TuneError> {
    let names: Vec<&str> = controller.fields().iter().map(|field| field.name).collect();
    match requests
        .iter()
        .find(|request| !names.contains(&request.name.as_str()))
    {
        Some(unknown) => Err(setting_error(
            &unknown.name,
            format!(
                "is not a setting of {}: there are {}",
                controller.name(),
                names.join(", ")
            ),
        )),
        None => Ok(()),
    }
}

fn setting_error(setting: &str, problem: String) -> TuneError {
    TuneError::Setting {
        setting: setting.to_owned(),
        problem,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        /// Every point is a controller whose text names it, in the ranges, with the initial settings at the centre.
        #[test]
        fn every_point_is_a_valid_controller(coordinates in prop::collection::vec(0.0..=1.0f64, 20)) {
            for spec in BuiltInController::all().iter().filter(|spec| !spec.fields().is_empty()) {
                let search = SettingSearch::parse(spec.name(), &[]).unwrap();
                let point = &coordinates[..search.searched().len()];
                let controller = search.controller_at(point);
                prop_assert_eq!(BuiltInController::parse(&controller.to_arg()), Some(Ok(controller.clone())));
                for ((field, value), setting) in controller.values().zip(search.searched()) {
                    prop_assert!((setting.range[0]..=setting.range[1]).contains(&value), "{}: {value}", field.name);
                }
                let [low, high] = [0.0, 1.0].map(|end| search.controller_at(&vec![end; point.len()]));
                let centre = search.controller_at(&vec![0.5; point.len()]);
                for (index, setting) in search.searched().iter().enumerate() {
                    let at = |spec: &BuiltInController| spec.values().nth(index).unwrap().1;
                    prop_assert_eq!([at(&low), at(&high)], setting.range);
                    let error = (at(&centre) - at(search.initial())).abs();
                    let [from, to] = setting.range;
                    let is_inside = from < at(search.initial()) && at(search.initial()) < to;
                    prop_assert!(!is_inside || error <= 1e-3 * (to - from), "{}: {error}", setting.field.name);
                }
            }
        }
    }

    #[test]
    fn requests_that_do_not_fit_are_named() {
        let request = |name: &str, range| SettingRequest {
            name: name.to_owned(),
            range,
        };
        let refused = |controller: &str, requests: &[SettingRequest]| {
            SettingSearch::parse(controller, requests)
                .unwrap_err()
                .to_string()
        };
        let ttc = |range| request("ttc_s", Some(range));
        assert!(refused("acc-aeb", &[ttc([-1.0, 1.0])]).ends_with("in 0..100"));
        assert!(refused("acc-aeb", &[ttc([0.0, f64::NAN])]).contains("a range must be"));
        assert!(
            refused("acc-aeb", &[ttc([0.0, 1.0]), ttc([0.0, 1.0])]).ends_with("is requested twice")
        );
        assert!(
            refused("acc-aeb,ttc_s=2", &[ttc([0.0, 1.0])])
                .starts_with("ttc_s: is fixed in the controller")
        );
        let search = SettingSearch::parse("acc-aeb", &[ttc([1.0, 2.0])]).unwrap();
        assert_eq!(search.controller_at(&[1.0]).to_arg(), "acc-aeb,ttc_s=2");
    }
}
