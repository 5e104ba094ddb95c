use super::super::map::SpeedUnit;
use super::*;

#[test]
fn units_in_the_file_hold_unless_the_map_states_them() {
    for (in_file, in_map, expected) in [
        ("km/h", None, Some(1.0 / 3.6)),
        ("km/h", Some(SpeedUnit::MetresPerSecond), Some(1.0)),
        ("m / sec", None, Some(1.0)),
        ("m/s²", None, None),
        ("", None, Some(1.0)),
        ("furlong", None, None),
    ] {
        let (fields, units) = (["v"].into_iter().collect(), [in_file].into_iter().collect());
        let names = CsvRow {
            fields,
            units,
            ..CsvRow::new(Path::new("a.mf4"), DecimalMark::Point)
        };
        let column = CsvColumn::find(&names, "v", SpeedUnit::of_column(in_map));
        assert_eq!(
            column.map(|column| column.factor).ok(),
            expected,
            "{in_file}"
        );
    }
}
