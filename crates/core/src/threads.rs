//! The number of threads of long work.

use std::env;
use std::thread;

/// Maximum number of threads that a user may request.
pub const MAX_THREADS: usize = 1024;

/// Variables of the environment that state a number of threads. The first one that is set counts.
const VARIABLES: [&str; 2] = ["RAYON_NUM_THREADS", "OMP_NUM_THREADS"];

/// A variable of the environment has no usable number of threads.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{variable}: must be a whole number from 0 to {MAX_THREADS}, found `{found}`")]
pub struct InvalidThreadCount {
    /// Name of the variable.
    pub variable: &'static str,
    /// Value of the variable.
    pub found: String,
}

/// Returns the number of threads: the requested one, else `RAYON_NUM_THREADS`, else `OMP_NUM_THREADS`, else the number
/// of cores that this process may use. The last one respects the affinity of the process and the quota of its control
/// group.
///
/// `OMP_NUM_THREADS` may be a list for nested levels, as in OpenMP 5.2, section 21.1.2; its first number counts. A
/// variable that is empty or 0 is not set, as in rayon.
///
/// # Errors
/// [`InvalidThreadCount`] if the variable that counts has no whole number up to [`MAX_THREADS`].
pub fn thread_count(requested: Option<usize>) -> Result<usize, InvalidThreadCount> {
    let cores = || thread::available_parallelism().map_or(1, usize::from);
    Ok(explicit_thread_count(requested)?.unwrap_or_else(cores))
}

/// Returns the number of threads that the user states: as [`thread_count`], but `None` if no setting has a number.
///
/// # Errors
/// [`InvalidThreadCount`], as [`thread_count`].
pub fn explicit_thread_count(
    requested: Option<usize>,
) -> Result<Option<usize>, InvalidThreadCount> {
    choose(requested, |name| {
        env::var_os(name).map(|value| value.to_string_lossy().into_owned())
    })
}

fn choose(
    requested: Option<usize>,
    value_of: impl Fn(&str) -> Option<String>,
) -> Result<Option<usize>, InvalidThreadCount> {
    if requested.is_some() {
        return Ok(requested.map(|count| count.clamp(1, MAX_THREADS)));
    }
    for variable in VARIABLES {
        let value = value_of(variable).unwrap_or_default();
        if let Some(count) = parse_count(variable, &value)? {
            return Ok(Some(count));
        }
    }
    Ok(None)
}

/// Reads the first number of a list; `None` if it is 0, or there is no text.
fn parse_count(variable: &'static str, value: &str) -> Result<Option<usize>, InvalidThreadCount> {
    let first = match variable {
        "OMP_NUM_THREADS" => value.split(',').next().unwrap_or_default().trim(),
        _ => value.trim(),
    };
    let invalid = || InvalidThreadCount {
        variable,
        found: value.to_owned(),
    };
    match first.parse() {
        _ if value.trim().is_empty() => Ok(None),
        Ok(0) => Ok(None),
        Ok(count @ 1..=MAX_THREADS) => Ok(Some(count)),
        _ => Err(invalid()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chosen(
        requested: Option<usize>,
        rayon: &str,
        open_mp: &str,
    ) -> Result<Option<usize>, String> {
        let value_of = |name: &str| match name {
            "RAYON_NUM_THREADS" => Some(rayon.to_owned()),
            _ => Some(open_mp.to_owned()).filter(|value| value != "unset"),
        };
        choose(requested, value_of).map_err(|invalid| invalid.to_string())
    }

    #[test]
    fn the_first_setting_with_a_positive_number_counts() {
        assert_eq!(chosen(Some(3), "many", "many"), Ok(Some(3)));
        assert_eq!(chosen(None, "5", "many"), Ok(Some(5)));
        for not_set in ["", " ", "0"] {
            assert_eq!(chosen(None, not_set, " 7 , 2"), Ok(Some(7)), "{not_set:?}");
            assert_eq!(chosen(None, not_set, not_set), Ok(None), "{not_set:?}");
            assert_eq!(chosen(None, not_set, "unset"), Ok(None), "{not_set:?}");
        }
        assert_eq!(chosen(None, "1024", ""), Ok(Some(MAX_THREADS)));
    }

    #[test]
    fn a_variable_without_a_usable_number_is_an_error() {
        for value in [
            "many",
            "-2",
            "4,2",
            "1.5",
            "1025",
            "99999999999999999999999",
        ] {
            let expected = format!(
                "RAYON_NUM_THREADS: must be a whole number from 0 to 1024, found `{value}`"
            );
            assert_eq!(chosen(None, value, "7"), Err(expected));
        }
        for value in ["many", ",2", "2 4", "2000,2"] {
            let expected =
                format!("OMP_NUM_THREADS: must be a whole number from 0 to 1024, found `{value}`");
            assert_eq!(chosen(None, "0", value), Err(expected));
        }
    }
}
