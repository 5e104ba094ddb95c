use super::super::map::SpeedUnit;
use super::*;

#[test]
fn units_of_the_file_apply_unless_the_map_states_them() {
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
        let column = CsvColumn::find(&names, "v", SpeedUnit::column_unit(in_map));
        assert_eq!(
            column.map(|column| column.factor).ok(),
            expected,
            "{in_file}"
        );
    }
}
