//! Robustness of each part of a formula over time.

use super::{Formula, MonitorError, SampledSignals};

/// A part of a formula, and its robustness at each sample.
#[derive(Debug, Clone, PartialEq)]
pub struct FormulaPart {
    /// Number of operators around it; 0 for the formula itself.
    pub depth: usize,
    /// The part.
    pub formula: Formula,
    /// Robustness at each sample; below 0 if and only if the part is violated there.
    pub robustness: Vec<f64>,
}

impl FormulaPart {
    /// Returns index and value of the sample with the least robustness; `None` without samples.
    #[must_use]
    pub fn least(&self) -> Option<(usize, f64)> {
        self.robustness
            .iter()
            .copied()
            .enumerate()
            .min_by(|(_, a), (_, b)| a.total_cmp(b))
    }
}

impl Formula {
    /// Returns the number of parts, the formula included.
    #[must_use]
    pub fn part_count(&self) -> usize {
        1 + self
            .operands()
            .into_iter()
            .map(Self::part_count)
            .sum::<usize>()
    }

    /// Returns the formula and its parts, each before its own parts, with their robustness over time.
    ///
    /// # Errors
    /// [`MonitorError`], as for [`Self::robustness`].
    pub fn parts_over_time(
        &self,
        signals: &SampledSignals<'_>,
    ) -> Result<Vec<FormulaPart>, MonitorError> {
        let mut parts = Vec::new();
        let mut open = vec![(0, self)];
        while let Some((depth, formula)) = open.pop() {
            let robustness = formula.decided_robustness(signals, signals.samples())?;
            parts.push(FormulaPart {
                depth,
                formula: formula.clone(),
                robustness,
            });
            open.extend(
                formula
                    .operands()
                    .into_iter()
                    .rev()
                    .map(|operand| (depth + 1, operand)),
            );
        }
        Ok(parts)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_operator_joins_the_robustness_of_its_parts() {
        let mut signals = SampledSignals::new(0.5, 4).unwrap();
        signals.insert("a", &[3.0, -2.0, 1.0, 4.0][..]).unwrap();
        signals.insert("b", &[1.0, 1.0, -5.0, 1.0][..]).unwrap();
        let formula: Formula = "always (a > 0 and b > -1)".parse().unwrap();
        let parts = formula.parts_over_time(&signals).unwrap();
        let depths: Vec<_> = parts
            .iter()
            .map(|part| (part.depth, part.formula.to_string()))
            .collect();
        let expected = [
            (0, formula.to_string()),
            (1, "(a > 0) and (b > -1)".to_owned()),
        ];
        assert_eq!(depths[..2], expected);
        assert_eq!(depths.len(), 4);
        let [whole, both, a, b] = [0, 1, 2, 3].map(|index| &parts[index].robustness);
        let smaller: Vec<_> = a.iter().zip(b).map(|(a, b)| a.min(*b)).collect();
        assert_eq!(*both, smaller);
        assert_eq!(*whole, [-4.0, -4.0, -4.0, 2.0]);
        assert_eq!(parts[2].least(), Some((1, -2.0)));

        let strict: Formula = "not (a > 1 or a <= 4)".parse().unwrap();
        let parts = strict.parts_over_time(&signals).unwrap();
        let violated: Vec<Vec<bool>> = parts
            .iter()
            .map(|part| part.robustness.iter().map(|&value| value < 0.0).collect())
            .collect();
        assert_eq!(
            violated,
            [
                [true; 4],
                [false; 4],
                [false, true, true, false],
                [false; 4]
            ]
        );
    }
}
