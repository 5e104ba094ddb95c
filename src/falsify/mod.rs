//! How it is attacked.

pub mod chasing_cars;
