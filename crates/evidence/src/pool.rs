//! One failure rate from the counts of several seeds, and its report.

mod json;
mod text;

use std::ops::RangeInclusive;

use crumple_controllers::Controllers;
use crumple_sim::engine::NamedController;
use crumple_verify::{Certificate, Pool, PoolRejection, PooledRate, WorkLimit};

use super::certificate_report::{describe_plants, is_built_in};
use super::{BindingError, CountsStatus, Rerun, RerunError, check_binding};

/// Reason why a certificate cannot be added to a pool.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PoolError {
    /// The certificate is rejected, or does not fit the others.
    #[error(transparent)]
    Rejected(#[from] PoolRejection),
    /// The certificate does not match its texts.
    #[error(transparent)]
    Binding(#[from] BindingError),
    /// The runs cannot be repeated.
    #[error(transparent)]
    Rerun(#[from] RerunError),
}

impl PoolError {
    /// True if the certificate is refuted; false if it could not be checked.
    #[must_use]
    pub fn is_refusal(&self) -> bool {
        match self {
            Self::Rejected(_) => true,
            Self::Binding(error) => !matches!(error, BindingError::StartRefused(_)),
            Self::Rerun(_) => false,
        }
    }
}

/// Check of the certificates of several seeds, one after the other.
pub struct PoolCheck {
    pool: Pool,
    limit: WorkLimit,
    controllers: Controllers,
    /// First certificate, which has the configuration of all.
    example: Option<Certificate>,
    /// Controllers for the repetition of runs, if it is wanted.
    given: Option<Vec<NamedController>>,
    /// Counts to repeat.
    rerun: Option<Rerun>,
}

impl PoolCheck {
    /// Creates a check of an empty pool. `limit` bounds the work for each certificate, and for the bound. `controllers`
    /// opens the drivers that spaces name as files.
    #[must_use]
    pub fn new(limit: WorkLimit, controllers: Controllers) -> Self {
        Self {
            pool: Pool::default(),
            limit,
            controllers,
            example: None,
            given: None,
            rerun: None,
        }
    }

    /// Accepts only these seeds, and none may be missing. Call it before [`add`](Self::add).
    #[must_use]
    pub fn with_expected_seeds(self, seeds: RangeInclusive<u64>) -> Self {
        Self {
            pool: Pool::of_seeds(seeds),
            ..self
        }
    }

    /// Prepares to repeat runs. Controllers that are not built in must be in `given`. Call it before
    /// [`add`](Self::add).
    #[must_use]
    pub fn with_rerun(self, given: Vec<NamedController>) -> Self {
        Self {
            given: Some(given),
            ..self
        }
    }

    /// Checks a certificate and its binding to its texts, and adds it.
    ///
    /// # Errors
    /// [`PoolError`] if it is refused, or cannot be checked.
    pub fn add(&mut self, certificate: &Certificate) -> Result<(), PoolError> {
        self.pool.add(certificate, self.limit)?;
        // The others have the same texts, and a registration that differs in the seed only.
        if self.example.is_none() {
            check_binding(certificate, None, self.controllers)?;
            self.example = Some(certificate.clone());
        }
        match (&mut self.rerun, &self.given) {
            (Some(rerun), _) => rerun.add(certificate)?,
            (None, Some(given)) => {
                self.rerun = Some(Rerun::new(certificate, given, self.controllers)?);
            }
            (None, None) => {}
        }
        Ok(())
    }

    /// Returns the counts to repeat, if [`with_rerun`](Self::with_rerun) prepared it and there is a certificate.
    #[must_use]
    pub fn rerun(&self) -> Option<&Rerun> {
        self.rerun.as_ref()
    }

    /// Concludes the bound that follows from all counts.
    ///
    /// # Errors
    /// [`PoolRejection`] if seeds are missing, there are too many runs, or the check takes too long.
    pub fn conclude(&self) -> Result<PoolReport, PoolRejection> {
        let claim = self.pool.conclude(self.limit)?;
        let example = self.example.as_ref().ok_or(PoolRejection::Empty)?;
        Ok(PoolReport {
            claim,
            certificates: self.pool.len(),
            counts: CountsStatus::Unconfirmed,
            space: example.provenance.scenario.clone(),
            is_built_in: is_built_in(example),
            plants: describe_plants(example, self.controllers),
        })
    }
}

/// Accepted claim of a pool.
#[derive(Debug)]
pub struct PoolReport {
    /// Claim that the checker proved.
    pub claim: PooledRate,
    /// Number of certificates.
    pub certificates: usize,
    /// Confirmation of the counts.
    pub counts: CountsStatus,
    /// Name of the space.
    space: String,
    is_built_in: Option<bool>,
    plants: Option<&'static str>,
}

/// A pool that the checker rejected, or a certificate of it.
#[derive(Debug)]
pub struct RejectedPool {
    /// Number of certificates.
    pub certificates: usize,
    /// Reason of the rejection.
    pub rejection: String,
}

impl PoolReport {
    /// True if repeated runs had other results.
    #[must_use]
    pub fn is_refuted(&self) -> bool {
        matches!(self.counts, CountsStatus::Refuted { .. })
    }
}
