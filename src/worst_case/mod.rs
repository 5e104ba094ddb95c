//! Convex programs: could anyone have avoided it, and how little does it take to make a controller fail.

mod avoid;
mod branches;
mod certificate;
mod cone;
mod multipliers;
mod program;
mod reason;
mod situation;
mod witness;

pub use avoid::{AvoidError, AvoidOptions, Avoidance, Verdict, avoid, certify};
pub use certificate::is_about;
pub use reason::Reason;
pub use witness::Escape;


#[doc(hidden)]
#[allow(missing_docs, clippy::all)]
pub fn probe() {
    use branches::Search;
    use program::Grid;
    use situation::Situation;
        for name in ["paper-1", "paper-2", "paper-3"] {
        for cell in [10, 1] {
            let s = Situation::new(&crate::scenario::built_in(name).unwrap()).unwrap();
            let t = std::time::Instant::now();
            let mut search = Search::new(&s);
            println!("{name} {:?}", t.elapsed());
            search.explore(&Grid::uniform(&s, cell), 60);
            println!("{:?} programs {} bound {} best {:?} trouble {:?}", t.elapsed(), search.programs, search.bound_m(), search.best.as_ref().map(|b| (b.firing, b.gap_m)), search.trouble);
        }}
}
