//! The properties of the claim that printing and binding need, and its check.

use super::table::HeightTable;
use super::{
    FARTHEST_GAP_M, InvariantClaim, InvariantController, MotionModel, NetworkReference,
    failing_cells,
};
use crate::assumption::Assumption;
use crate::certificate::CertificateProvenance;
use crate::interval::Interval;
use crate::number::{round_down, round_up};
use crate::reach::{check_policy_file_name, describe_network};
use crate::rejection::Rejection;
use crate::scope::{NO_VEHICLE_BEHIND, Scope, describe_errors};
use crate::{CheckInput, Claim, ClaimSubject, ProvedClaim};

impl Claim for InvariantClaim {
    fn name(&self) -> &'static str {
        "invariant"
    }

    fn subject(&self) -> ClaimSubject<'_> {
        ClaimSubject::Region(self)
    }

    fn assumptions(&self) -> Vec<Assumption> {
        let always = [
            Assumption::ExactMotion,
            Assumption::LeaderWithinLimit,
            Assumption::PolicyDrives,
            Assumption::ObservedWithin,
        ];
        let network = self.network();
        let is_imported = network.is_some_and(|network| network.source.is_some());
        let of_source = [Assumption::ExpWithin, Assumption::NetworkAsRead];
        always
            .into_iter()
            .chain(network.map(|_| Assumption::TanhWithin))
            .chain(of_source.into_iter().filter(|_| is_imported))
            .chain([Assumption::SpeedsWithin])
            .collect()
    }

    fn scope(&self) -> Scope {
        let vehicles = vec![describe_leader(self), describe_own_vehicle(self)];
        let decides = match self.decision_steps {
            1 => format!("a decision in each step of {} s", self.step_s),
            steps => format!("a decision every {steps} steps of {} s", self.step_s),
        };
        let ends = self
            .ends_beyond_gap_m
            .map(|gap_m| format!("until a gap exceeds {gap_m} m"));
        let limits = [decides, observation_errors(self)]
            .into_iter()
            .chain(ends)
            .collect();
        let behind = match &self.controller {
            InvariantController::Law(_) => "behind: not considered",
            InvariantController::Network(_) => NO_VEHICLE_BEHIND,
        };
        Scope {
            behind: Some(behind.to_owned()),
            ..Scope::new(Some(f64::INFINITY), vehicles, limits)
        }
    }

    fn check_fields(&self, _provenance: &CertificateProvenance) -> Result<(), Rejection> {
        match self.network() {
            None => Ok(()),
            Some(network) => check_policy_file_name(
                &network.policy_file,
                &network.policy_sha256,
                network.source.is_some(),
            ),
        }
    }

    fn check(&self, input: &CheckInput<'_>) -> Result<ProvedClaim, Rejection> {
        let closed_loop = self.closed_loop(input.policy, input.work)?;
        let table = HeightTable::from_runs(self.axes, &self.heights)?;
        self.check_axes(&table)?;
        let [lowest_m, _] = table.extremes();
        let min_gap_m = (Interval::point(lowest_m) - Interval::point(self.floor_m())).low();
        if min_gap_m.is_nan() || min_gap_m <= 0.0 {
            return Err(Rejection::invalid(
                "heights",
                "are too small to exclude a collision between decisions",
            ));
        }
        let failed = failing_cells(&closed_loop, &table, 1);
        // The verdict does not depend on which thread first exceeded the budget.
        input.work.charge_or_reject(0)?;
        if let Some(&(cell, missing_m)) = failed.first() {
            return Err(Rejection::LeavesSet { cell, missing_m });
        }
        let share = self.share(&table)?;
        let own_speed_is_kept = closed_loop.keeps_own_speed(&table, FARTHEST_GAP_M);
        for (field, stated, proved) in [
            ("share_at_least", self.share_at_least, share),
            ("min_gap_m_at_least", self.min_gap_m_at_least, min_gap_m),
        ] {
            if stated.is_nan() || proved.is_nan() || stated > proved {
                return Err(Rejection::invalid(field, "exceeds the proved value"));
            }
        }
        Ok(ProvedClaim::Invariant {
            share,
            min_gap_m,
            own_speed_is_kept,
        })
    }
}

fn describe_leader(claim: &InvariantClaim) -> String {
    let accelerates = match claim.leader_mps2 {
        [0.0, 0.0] => "constant".to_owned(),
        [least, most] => format!("accelerates as it likes from {least} to {most} m/s²"),
    };
    let [_, speeds] = claim.axes;
    match claim.motion {
        MotionModel::Absolute => format!(
            "leader: {} to {} m/s, {accelerates}",
            round_up(speeds.low),
            round_down(speeds.high)
        ),
        MotionModel::Relative => format!("leader: any speed, {accelerates}; no standstill"),
    }
}

fn describe_own_vehicle(claim: &InvariantClaim) -> String {
    let driver = match &claim.controller {
        InvariantController::Law(law) => law.to_string(),
        InvariantController::Network(NetworkReference {
            policy_sha256,
            source,
            ..
        }) => format!(
            "driven by the {}",
            describe_network(policy_sha256, source.as_ref())
        ),
    };
    let speed = match claim.motion {
        MotionModel::Absolute => "speed",
        MotionModel::Relative => "closing speed",
    };
    let [speeds, _] = claim.axes;
    let [brake, accel] = claim.own_mps2;
    format!(
        "under test: {speed} up to {} m/s (at the start up to {}), from {brake} to {accel} m/s², {driver}",
        round_down(speeds.high),
        round_down(claim.initial_own_mps_at_most)
    )
}

/// Describes the observation errors of an invariant claim. A network may observe any acceleration within the limits.
fn observation_errors(claim: &InvariantClaim) -> String {
    let [gap, own, leader] = claim.observation_error;
    let errors = describe_errors(&[
        ("gap", gap, "m"),
        ("own speed", own, "m/s"),
        ("leader's speed", leader, "m/s"),
    ]);
    match &claim.controller {
        InvariantController::Law(_) => errors,
        InvariantController::Network(_) => {
            format!("{errors}; observed accelerations are any within the limits of the vehicles")
        }
    }
}
