//! Speed against accuracy, charted: every method on every backend over sizes and tolerances.
//!
//! [`Plan`] says what is run; [`run`](Plan::run) does it, one [`Case`] after the other, each of them in a
//! process of its own, and keeps what is finished in a file of lines, so that an interrupted chart goes
//! on where it stopped. What comes out are tables, JSON and pictures of
//!
//! - the error against the time of whole solves ([`measure`]), against point truth and, where there is one,
//!   surface truth ([`truth`]);
//! - time and memory against the number of points, with their exponents ([`fit`]);
//! - the error and the time of one application against the order, in both bases ([`orders`]);
//! - each stage on the adapter against the CPU ([`stages`]).

pub mod closed_forms;
mod draw;
pub mod fit;
mod machine;
mod measure;
pub mod orders;
mod plan;
mod records;
pub mod stages;
mod tables;
pub mod truth;
mod usage;

pub use machine::Machine;
pub use measure::{Case, Measured, Solve, measure};
pub use orders::OrderRow;
pub use plan::{Charted, FILES, Plan};
pub use stages::StageRow;
pub use usage::{Clock, Spent, median};
