//! What a stationary, turning IMU can tell: the observability of its errors, and how fast they become known.
//!
//! # Rank (\[Du17\])
//!
//! Twelve errors in n = ENU: velocity δv, attitude ε, accelerometer biases γ, gyro biases d, measured by the velocity.
//! The sensor turns in the body with a constant rate, so biases that are constant in the sensor turn in n:
//!
//! ```text
//! δv̇ = Ω_v δv + F_n ε + γ      ε̇ = d      γ̇ = R γ      ḋ = R d             (7), (10)
//! R = C_b^n [ω_bs^b ×] C_n^b                                               (9)
//! F_n = [f^n ×]ᵀ with f^n = (f_E, f_N, g)                                  below (37)
//! Q = [H; H F; … H F¹¹],   H = [I 0 0 0]                                   (13)
//! ```
//!
//! F is constant while the rate is, so that one Q holds for one [`Segment`]; several stack up as those of a piecewise
//! constant system, each carried back to the start by the transitions before it (Goshen-Meskin, Bar-Itzhack, IEEE Trans.
//! AES 28, 1992, the total observability matrix).
//!
//! The rank is that of floating-point numbers: singular values below [`RANK_TOLERANCE`] of the largest are nothing. For
//! that to mean anything the states must be of one size. They are scaled by g and by the time T in which the sensor turns
//! by a radian: velocities by gT, accelerations by g, rates by 1/T. Then every block of F is near one, except for
//! Earth's rate (2 ω_ie T), and what should be zero comes out near 1e-16.
//!
//! What counts is the tilt of the rotation axis alone: 8 about a vertical one, 10 about a level one, 11 about any other.
//!
//! # Size (\[Yu15\] (18), (27))
//!
//! [`SquareRootInformation`] gathers weighted measurement rows about the state at a reference time, by orthogonal
//! transformations. The normal matrix HᵀR⁻¹H of the \[Yu15\] model has a condition number near 1e15 without a prior; its
//! square root has the root of it, and loses nothing that matters in f64.
//!
//! Not modelled: process noise, motion of the base, the coupling of attitude errors by Earth's rate, which \[Du17\] leaves out of
//! (7) since it drowns in a MEMS gyro's bias.

use frames::units::DEG;
use nalgebra::{DMatrix, Matrix3, RowSVector, SMatrix, SVector, Vector3};
use nav::earth::Earth;
use serde::Serialize;

/// Number of error states of \[Du17\].
pub const STATES: usize = 12;
/// Names of the states, in their order.
pub const NAMES: [&str; STATES] = [
    "δv_E", "δv_N", "δv_U", "ε_E", "ε_N", "ε_U", "γ_E", "γ_N", "γ_U", "d_E", "d_N", "d_U",
];
/// Singular values below this part of the largest count as zero. A tilt of 0.001° still leaves
/// 3e-6, rounding less than 1e-15.
pub const RANK_TOLERANCE: f64 = 1e-12;

/// Vector of the error states.
pub type State = SVector<f64, STATES>;
/// Matrix over the error states.
pub type Matrix12 = SMatrix<f64, STATES, STATES>;

/// The axis of the body that the sensor turns about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Axis {
    /// Not turning.
    None,
    /// Right.
    X,
    /// Front.
    Y,
    /// Up.
    Z,
}

impl Axis {
    fn unit(self) -> Vector3<f64> {
        match self {
            Self::None => Vector3::zeros(),
            Self::X => Vector3::x(),
            Self::Y => Vector3::y(),
            Self::Z => Vector3::z(),
        }
    }
}

/// Attitude of the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Attitude {
    /// Clockwise from north, rad.
    pub heading: f64,
    /// Nose up, rad.
    pub pitch: f64,
    /// Right side down, rad.
    pub roll: f64,
}

impl Attitude {
    /// `C_b^n = Rz(−heading) Rx(pitch) Ry(roll)`.
    pub fn c_nb(&self) -> Matrix3<f64> {
        let turn = |axis, angle| *nalgebra::Rotation3::from_axis_angle(&axis, angle).matrix();
        turn(Vector3::z_axis(), -self.heading)
            * turn(Vector3::x_axis(), self.pitch)
            * turn(Vector3::y_axis(), self.roll)
    }
}

/// A time with one rotation rate and one acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Axis that the sensor turns about.
    pub axis: Axis,
    /// Its rate, rad/s; not used without an axis.
    pub rate: f64,
    /// Length, s: what carries one segment to the next. The last one's does not count.
    pub seconds: f64,
    /// Acceleration east and north, m/s² ((36), (37)).
    pub acceleration: [f64; 2],
}

/// Why there is no answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ObservabilityError {
    /// No segment.
    NoSegment,
    /// A figure is not finite, or a length not positive.
    Figure,
    /// A segment has an axis and no rate.
    NoRate,
    /// The place is not one where a unit could be: latitude beyond 85° or not finite.
    Place(nav::earth::EarthError),
    /// The singular values do not converge.
    Diverged,
}

impl core::fmt::Display for ObservabilityError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NoSegment => f.write_str("no rotation segment"),
            Self::Figure => f.write_str("angles, rates, times and accelerations must be finite, and times positive"),
            Self::NoRate => f.write_str("turning about an axis takes a rate other than zero"),
            Self::Place(e) => write!(f, "{e}"),
            Self::Diverged => f.write_str("the singular values of the observability matrix do not converge"),
        }
    }
}

impl core::error::Error for ObservabilityError {}

/// The rows of scaled states that are observable, and what follows from them.
#[derive(Debug, Clone, PartialEq)]
pub struct Observability {
    /// Singular values of the scaled Q, largest first.
    pub singular_values: [f64; STATES],
    /// How many of them are not zero.
    pub rank: usize,
    /// Orthonormal basis of the observable directions, in scaled states.
    basis: Vec<RowSVector<f64, STATES>>,
    /// State = scale × scaled state.
    scale: State,
}

/// One state, or one direction, and how much of it is observable.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Seen {
    /// By itself.
    Alone,
    /// Only in combination with others.
    Jointly,
    /// Not at all.
    Not,
}

impl core::fmt::Display for Seen {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.pad(match self {
            Self::Alone => "observable",
            Self::Jointly => "jointly",
            Self::Not => "unobservable",
        })
    }
}

/// Directions nearer to the observable space than this, or to its complement, lie in it: rounding leaves 1e-15 of a
/// clear case, and divides by the tilt where it is small.
const IN_SPACE: f64 = 1e-7;

impl Observability {
    /// Of a body at rest in this attitude and at this latitude (rad), over these segments.
    ///
    /// # Errors
    /// [`ObservabilityError`] where a figure cannot be.
    pub fn of(attitude: &Attitude, latitude: f64, segments: &[Segment]) -> Result<Self, ObservabilityError> {
        let finite = |x: &f64| x.is_finite();
        let angles = [attitude.heading, attitude.pitch, attitude.roll];
        if segments.is_empty() {
            return Err(ObservabilityError::NoSegment);
        }
        let possible = |s: &Segment| {
            s.rate.is_finite() && s.seconds.is_finite() && s.seconds > 0.0 && s.acceleration.iter().all(finite)
        };
        if !(angles.iter().all(finite) && segments.iter().all(possible)) {
            return Err(ObservabilityError::Figure);
        }
        if segments.iter().any(|s| s.axis != Axis::None && s.rate == 0.0) {
            return Err(ObservabilityError::NoRate);
        }
        let earth = Earth::<f64>::new(latitude, 0.0).map_err(ObservabilityError::Place)?;
        let g = earth.gravity();
        // Time in which the fastest turn makes one radian; a second without any.
        let fastest = segments
            .iter()
            .filter(|s| s.axis != Axis::None)
            .map(|s| s.rate.abs())
            .fold(0.0, f64::max);
        let time = if fastest > 0.0 { fastest.recip() } else { 1.0 };
        let c_nb = attitude.c_nb();

        let mut rows: Vec<RowSVector<f64, STATES>> = Vec::new();
        // Transition from the start to the segment at hand.
        let mut carried = Matrix12::identity();
        for segment in segments {
            let f = system(segment, &c_nb, &earth, time);
            let mut block = SMatrix::<f64, 3, STATES>::zeros();
            block.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
            for _ in 0..STATES {
                // No block may outshine the rest only because it is a high power or carried far.
                let seen = block * carried;
                let size = seen.norm().max(1.0);
                rows.extend(seen.row_iter().map(|row| row / size));
                block *= f;
            }
            carried = (f * (segment.seconds / time)).exp() * carried;
        }
        let q = DMatrix::from_fn(rows.len(), STATES, |i, j| rows[i][j]);
        let svd = q
            .try_svd(false, true, f64::EPSILON, 0)
            .ok_or(ObservabilityError::Diverged)?;
        let v_t = svd.v_t.ok_or(ObservabilityError::Diverged)?;
        let singular_values: [f64; STATES] = core::array::from_fn(|k| svd.singular_values[k]);
        let least = RANK_TOLERANCE * singular_values[0];
        let rank = singular_values.iter().filter(|s| **s > least).count();
        Ok(Self {
            singular_values,
            rank,
            basis: (0..rank).map(|k| RowSVector::from_fn(|_, j| v_t[(k, j)])).collect(),
            scale: scales(g, time),
        })
    }

    /// The smallest singular value that counts and the largest that does not, as parts of the largest; a rank is
    /// certain where they lie far apart.
    pub fn gap(&self) -> (f64, f64) {
        let part = |k: usize| self.singular_values.get(k).map_or(0.0, |s| s / self.singular_values[0]);
        (part(self.rank.saturating_sub(1)), part(self.rank))
    }

    /// How far the combination `Σ c_i x_i` is from what is observable: 0 in it, 1 perpendicular to all of it. Each of
    /// its terms counts by its size in scaled states.
    pub fn distance(&self, combination: &State) -> f64 {
        let direction = combination.component_mul(&self.scale).normalize();
        let seen = self.basis.iter().fold(State::zeros(), |sum, row| {
            let column = row.transpose();
            sum + column * column.dot(&direction)
        });
        (direction - seen).norm()
    }

    /// How much of the combination `Σ c_i x_i` is observable.
    pub fn seen(&self, combination: &State) -> Seen {
        let outside = self.distance(combination);
        if outside < IN_SPACE {
            Seen::Alone
        } else if outside > (1.0 - IN_SPACE * IN_SPACE).min(1.0 - 1e-12) {
            Seen::Not
        } else {
            Seen::Jointly
        }
    }

    /// How much of one state is observable.
    pub fn state(&self, index: usize) -> Seen {
        self.seen(&State::ith(index, 1.0))
    }

    /// The observable combinations, as many as the rank: Σ c_i x_i in the states' own units, reduced so that each
    /// begins with a state that no other has.
    pub fn combinations(&self) -> Vec<State> {
        let mut rows = self.basis.clone();
        let mut done = 0;
        for column in 0..STATES {
            let candidates = rows.iter().enumerate().skip(done);
            let Some((pivot, size)) = candidates
                .map(|(k, row)| (k, row[column].abs()))
                .max_by(|a, b| a.1.total_cmp(&b.1))
            else {
                break;
            };
            if size < IN_SPACE {
                continue;
            }
            rows.swap(done, pivot);
            let leading = rows[done] / rows[done][column];
            for (k, row) in rows.iter_mut().enumerate() {
                *row = if k == done {
                    leading
                } else {
                    *row - leading * row[column]
                };
            }
            done += 1;
        }
        rows.iter()
            .map(|row| {
                let mut combination = row.transpose();
                for c in combination.iter_mut().filter(|c| c.abs() < IN_SPACE) {
                    *c = 0.0;
                }
                combination.component_div(&self.scale)
            })
            .collect()
    }

    /// [`combinations`](Self::combinations) in words: coefficients multiply acceleration-like terms, so that an angle
    /// comes with g, and a rate with g/ω, the speed of turning.
    pub fn words(&self) -> Vec<String> {
        self.combinations()
            .iter()
            .map(|c| {
                let mut text = String::new();
                let scaled = c.component_mul(&self.scale);
                let terms: Vec<_> = scaled.iter().enumerate().filter(|(_, c)| **c != 0.0).collect();
                for (k, c) in &terms {
                    let unit = match k {
                        3..6 if terms.len() > 1 => "g ",
                        9..12 if terms.len() > 1 => "g/ω ",
                        _ => "",
                    };
                    let size = if (c.abs() - 1.0).abs() < 1e-6 {
                        String::new()
                    } else {
                        format!("{:.4} ", c.abs())
                    };
                    let sign = match (text.is_empty(), **c < 0.0) {
                        (true, false) => "",
                        (true, true) => "−",
                        (false, false) => " + ",
                        (false, true) => " − ",
                    };
                    text += &format!("{sign}{size}{unit}{}", NAMES[*k]);
                }
                text
            })
            .collect()
    }
}

/// State = scale × scaled state: gT, 1, g, 1/T.
fn scales(g: f64, time: f64) -> State {
    State::from_fn(|k, _| [g * time, 1.0, g, time.recip()][k / 3])
}

/// F of (10) with F_n of (36), (37), in SI units: ẋ = F x of a body in this attitude, at this place.
pub fn dynamics(attitude: &Attitude, earth: &Earth<f64>, segment: &Segment) -> Matrix12 {
    let scale = scales(earth.gravity(), 1.0);
    let f = system(segment, &attitude.c_nb(), earth, 1.0);
    Matrix12::from_fn(|i, j| scale[i] * f[(i, j)] / scale[j])
}

/// F of (10) with F_n of (36), (37), in scaled states and scaled time.
fn system(segment: &Segment, c_nb: &Matrix3<f64>, earth: &Earth<f64>, time: f64) -> Matrix12 {
    let g = earth.gravity();
    // −2 ω_ie^n × δv: the printed Ω_v.
    let coriolis = -earth.w_ie_n().vector().cross_matrix() * 2.0 * time;
    // F_n ε of (36), (37) is f^n × ε turned about: ε of [Du17] turns the computed frame, f × ε = −ε × f.
    let [east, north] = segment.acceleration;
    let force = -Vector3::new(east / g, north / g, 1.0).cross_matrix();
    let rate = c_nb * segment.axis.unit() * (segment.rate * time);
    let turn = rate.cross_matrix();
    let identity = Matrix3::identity();
    let mut f = Matrix12::zeros();
    f.fixed_view_mut::<3, 3>(0, 0).copy_from(&coriolis);
    f.fixed_view_mut::<3, 3>(0, 3).copy_from(&force);
    f.fixed_view_mut::<3, 3>(0, 6).copy_from(&identity);
    f.fixed_view_mut::<3, 3>(3, 9).copy_from(&identity);
    f.fixed_view_mut::<3, 3>(6, 6).copy_from(&turn);
    f.fixed_view_mut::<3, 3>(9, 9).copy_from(&turn);
    f
}

/// Square root of an information matrix: upper triangular S with SᵀS = P⁻¹, about the state at one reference time.
///
/// A measurement z = h·x with white noise of variance r adds the row h/√r; one of continuous noise of density r over dt
/// the row h √(dt/r). A prior is a row for each state. Rows are gathered and rotated into S by Householder
/// transformations, some at a time, for speed.
#[derive(Debug, Clone, PartialEq)]
pub struct SquareRootInformation<const N: usize> {
    root: SMatrix<f64, N, N>,
    pending: Vec<RowSVector<f64, N>>,
}

impl<const N: usize> Default for SquareRootInformation<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> SquareRootInformation<N> {
    /// Rows that are gathered before a transformation.
    const GATHERED: usize = 64;

    /// Nothing known.
    pub fn new() -> Self {
        Self {
            root: SMatrix::zeros(),
            pending: Vec::with_capacity(Self::GATHERED),
        }
    }

    /// States known with these 1σ, independently.
    pub fn prior(sd: &SVector<f64, N>) -> Self {
        Self {
            root: SMatrix::from_diagonal(&sd.map(f64::recip)),
            ..Self::new()
        }
    }

    /// Adds a measurement: its row, divided by its 1σ.
    pub fn push(&mut self, row: RowSVector<f64, N>) {
        self.pending.push(row);
        if self.pending.len() >= Self::GATHERED {
            self.rotate();
        }
    }

    /// Adds all that `other` knows, weighted by `weight` (1/σ, where `other` has been gathered with a σ of one).
    pub fn merge(&mut self, other: &Self, weight: f64) {
        for row in other.root.row_iter() {
            self.push(row * weight);
        }
        for row in &other.pending {
            self.push(row * weight);
        }
    }

    /// Householder: the stack of S and the gathered rows becomes a new S.
    ///
    /// S keeps its triangle, so that column k has its pivot and the gathered rows to bring to zero, and no more.
    fn rotate(&mut self) {
        let rows = &mut self.pending;
        for k in 0..N {
            let below: f64 = rows.iter().map(|r| r[k] * r[k]).sum();
            if below == 0.0 {
                continue;
            }
            let pivot = self.root[(k, k)];
            let size = (pivot * pivot + below).sqrt().copysign(-pivot);
            let head = pivot - size;
            let scale = 2.0 / (head * head + below);
            for j in k..N {
                let along = head * self.root[(k, j)] + rows.iter().map(|r| r[k] * r[j]).sum::<f64>();
                if j == k {
                    continue;
                }
                let step = scale * along;
                self.root[(k, j)] -= step * head;
                for r in rows.iter_mut() {
                    let own = r[k];
                    r[j] -= step * own;
                }
            }
            self.root[(k, k)] = size;
            for r in rows.iter_mut() {
                r[k] = 0.0;
            }
        }
        rows.clear();
    }

    /// 1σ of the state that `phi` carries the reference state to; infinite where nothing is known.
    ///
    /// P = Φ S⁻¹ (Φ S⁻¹)ᵀ: one triangular solution, and no matrix is squared.
    pub fn sd(&mut self, phi: &SMatrix<f64, N, N>) -> SVector<f64, N> {
        self.rotate();
        // W S = Φ, column by column from the left.
        let mut w = *phi;
        for k in 0..N {
            let mut column = w.column(k).clone_owned();
            for j in 0..k {
                let s = self.root[(j, k)];
                column -= w.column(j) * s;
            }
            w.set_column(k, &(column / self.root[(k, k)]));
        }
        SVector::from_fn(|i, _| {
            let variance = w.row(i).norm_squared();
            if variance.is_finite() {
                variance.sqrt()
            } else {
                f64::INFINITY
            }
        })
    }

    /// Singular values of S, largest first, each column scaled to unit length: how well the states are told apart
    /// whatever their units.
    pub fn scaled_singular_values(&mut self) -> Vec<f64> {
        self.rotate();
        let mut scaled = self.root;
        for mut column in scaled.column_iter_mut() {
            let size = column.norm();
            if size > 0.0 {
                column /= size;
            }
        }
        let dynamic = DMatrix::from_fn(N, N, |i, j| scaled[(i, j)]);
        dynamic.singular_values().iter().copied().collect()
    }
}

/// Result of the command, for JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Rank of Q.
    pub rank: usize,
    /// Number of states.
    pub states: usize,
    /// Singular values of the scaled Q, largest first.
    pub singular_values: [f64; STATES],
    /// Smallest of those that count, as a part of the largest.
    pub smallest_counted: f64,
    /// Largest of those that do not.
    pub largest_neglected: f64,
    /// Tilt of each segment's axis from the level, degrees; none where it does not turn.
    pub axis_elevation_deg: Vec<Option<f64>>,
    /// Observable combinations.
    pub observable: Vec<String>,
    /// Each state of n.
    pub by_state: Vec<StateReport>,
    /// Biases along the axes of the body, where the sensor stands at the start.
    pub by_body_axis: Vec<StateReport>,
}

/// One state and whether it is observable.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StateReport {
    /// Its name.
    pub name: String,
    /// Whether.
    pub seen: Seen,
}

impl Report {
    /// Of a body in this attitude, at this latitude (rad), over these segments.
    ///
    /// # Errors
    /// [`ObservabilityError`] where a figure cannot be.
    pub fn of(attitude: &Attitude, latitude: f64, segments: &[Segment]) -> Result<Self, ObservabilityError> {
        let found = Observability::of(attitude, latitude, segments)?;
        let c_nb = attitude.c_nb();
        let (smallest_counted, largest_neglected) = found.gap();
        let names = ["γ_X", "γ_Y", "γ_Z", "d_X", "d_Y", "d_Z"];
        Ok(Self {
            rank: found.rank,
            states: STATES,
            singular_values: found.singular_values,
            smallest_counted,
            largest_neglected,
            axis_elevation_deg: segments
                .iter()
                .map(|s| (s.axis != Axis::None).then(|| (c_nb * s.axis.unit()).z.clamp(-1.0, 1.0).asin() / DEG))
                .collect(),
            observable: found.words(),
            by_state: (0..STATES)
                .map(|k| StateReport {
                    name: NAMES[k].to_owned(),
                    seen: found.state(k),
                })
                .collect(),
            by_body_axis: names
                .iter()
                .enumerate()
                .map(|(k, name)| StateReport {
                    name: (*name).to_owned(),
                    seen: found.seen(&body_bias(&c_nb, k)),
                })
                .collect(),
        })
    }
}

/// The combination that is the bias along a body axis: 0 to 2 of the accelerometers, 3 to 5 of the gyros.
pub fn body_bias(c_nb: &Matrix3<f64>, index: usize) -> State {
    let mut combination = State::zeros();
    let start = 6 + 3 * (index / 3);
    combination
        .fixed_rows_mut::<3>(start)
        .copy_from(&c_nb.column(index % 3));
    combination
}

#[cfg(test)]
mod tests {
    use super::*;

    const AXES: [Axis; 3] = [Axis::X, Axis::Y, Axis::Z];

    fn segment(axis: Axis, rate_dps: f64) -> Segment {
        Segment {
            axis,
            rate: rate_dps * DEG,
            seconds: 36.0,
            acceleration: [0.0; 2],
        }
    }

    fn attitude(heading: f64, pitch: f64, roll: f64) -> Attitude {
        Attitude {
            heading: heading * DEG,
            pitch: pitch * DEG,
            roll: roll * DEG,
        }
    }

    fn found(attitude: Attitude, segments: &[Segment]) -> Observability {
        let found = Observability::of(&attitude, 40.0 * DEG, segments).unwrap();
        let (counted, neglected) = found.gap();
        assert!(counted > 1e3 * neglected, "rank in doubt: {found:?}");
        found
    }

    #[test]
    fn ranks_of_the_paper() {
        for heading in [0.0, 30.0, 90.0, 137.0, 270.0] {
            for rate in [0.5, 10.0, -40.0, 100.0] {
                let rank = |axis, pitch, roll| found(attitude(heading, pitch, roll), &[segment(axis, rate)]).rank;
                // Property 1.
                assert_eq!(rank(Axis::None, 0.0, 0.0), 8);
                assert_eq!(rank(Axis::None, 30.0, 20.0), 8);
                // Property 3: pitch does not matter.
                assert_eq!(rank(Axis::X, 0.0, 0.0), 10);
                assert_eq!(rank(Axis::X, 30.0, 0.0), 10);
                assert_eq!(rank(Axis::X, 0.0, 30.0), 11);
                assert_eq!(rank(Axis::X, 30.0, 5.0), 11);
                // Property 4: roll does not matter.
                assert_eq!(rank(Axis::Y, 0.0, 0.0), 10);
                assert_eq!(rank(Axis::Y, 0.0, 30.0), 10);
                assert_eq!(rank(Axis::Y, 30.0, 0.0), 11);
                // Property 5.
                assert_eq!(rank(Axis::Z, 0.0, 0.0), 8);
                assert_eq!(rank(Axis::Z, 30.0, 0.0), 11);
                assert_eq!(rank(Axis::Z, 0.0, 1.0), 11);
            }
        }
    }

    #[test]
    fn the_axis_elevation_alone_decides() {
        let rank = |axis, pitch, roll| found(attitude(20.0, pitch, roll), &[segment(axis, 10.0)]).rank;
        // Vertical x, by roll, and vertical y, by pitch; a level z, by either.
        assert_eq!(rank(Axis::X, 0.0, 90.0), 8);
        assert_eq!(rank(Axis::Y, 90.0, 0.0), 8);
        assert_eq!(rank(Axis::Z, 90.0, 0.0), 10);
        assert_eq!(rank(Axis::Z, 0.0, -90.0), 10);
    }

    #[test]
    fn a_small_tilt_counts() {
        for axis in AXES {
            let tilted = found(attitude(50.0, 0.01, 0.01), &[segment(axis, 10.0)]);
            assert_eq!(tilted.rank, 11, "{axis:?} {:?}", tilted.singular_values);
        }
    }

    #[test]
    fn combinations_of_property_one() {
        let found = found(attitude(0.0, 0.0, 0.0), &[segment(Axis::None, 0.0)]);
        assert_eq!(
            found.words(),
            [
                "δv_E",
                "δv_N",
                "δv_U",
                "g ε_E − γ_N",
                "g ε_N + γ_E",
                "γ_U",
                "d_E",
                "d_N"
            ]
        );
        assert_eq!(found.state(5), Seen::Not);
        assert_eq!(found.state(11), Seen::Not);
        assert_eq!(found.state(6), Seen::Jointly);
        assert_eq!(found.state(8), Seen::Alone);
    }

    #[test]
    fn turning_leaves_azimuth_alone_unknown() {
        for axis in AXES {
            let found = found(attitude(30.0, 20.0, 10.0), &[segment(axis, 10.0)]);
            for (k, name) in NAMES.iter().enumerate() {
                let expected = if k == 5 { Seen::Not } else { Seen::Alone };
                assert_eq!(found.state(k), expected, "{axis:?} {name}");
            }
        }
    }

    #[test]
    fn the_bias_along_a_level_axis_stays_joint() {
        // Property 3 in the sensor's axes, (24).
        let body = attitude(30.0, 20.0, 0.0);
        let found = found(body, &[segment(Axis::X, 10.0)]);
        let seen: Vec<_> = (0..6).map(|k| found.seen(&body_bias(&body.c_nb(), k))).collect();
        assert_eq!(
            seen,
            [
                Seen::Jointly,
                Seen::Alone,
                Seen::Alone,
                Seen::Alone,
                Seen::Alone,
                Seen::Alone
            ]
        );
    }

    #[test]
    fn azimuth_takes_a_change_of_acceleration() {
        let level = attitude(0.0, 30.0, 0.0);
        let turning = segment(Axis::Y, 10.0);
        let pushed = Segment {
            acceleration: [0.5, 1.0],
            ..turning
        };
        // With one constant acceleration the error about f itself never shows.
        assert_eq!(found(level, &[pushed]).rank, 11);
        assert_eq!(found(level, &[turning, pushed]).rank, 12);
        // Not turning, a change of acceleration tells azimuth, and the up gyro by it, but no level accelerometer.
        let (still, pushed) = (
            segment(Axis::None, 0.0),
            Segment {
                acceleration: [0.5, 1.0],
                ..segment(Axis::None, 0.0)
            },
        );
        assert!(found(level, &[still, pushed]).rank > 8);
        assert!(found(level, &[still, pushed]).rank < 12);
    }

    #[test]
    fn two_axes_one_after_the_other() {
        let level = attitude(0.0, 0.0, 0.0);
        assert_eq!(found(level, &[segment(Axis::X, 10.0), segment(Axis::Y, 10.0)]).rank, 11);
        assert_eq!(
            found(level, &[segment(Axis::Z, 10.0), segment(Axis::Z, -10.0)]).rank,
            10
        );
    }

    #[test]
    fn impossible_figures_are_refused() {
        let level = attitude(0.0, 0.0, 0.0);
        let of = |segments: &[Segment]| Observability::of(&level, 0.7, segments).map(|o| o.rank);
        assert_eq!(of(&[]), Err(ObservabilityError::NoSegment));
        assert_eq!(of(&[segment(Axis::X, 0.0)]), Err(ObservabilityError::NoRate));
        assert_eq!(of(&[segment(Axis::X, f64::NAN)]), Err(ObservabilityError::Figure));
        assert!(Observability::of(&level, 1.56, &[segment(Axis::X, 1.0)]).is_err());
    }

    #[test]
    fn information_of_a_straight_line() {
        // x = a + b t, measured n times with σ: closed form of the slope's variance.
        let mut information = SquareRootInformation::<2>::new();
        assert!(information.sd(&SMatrix::identity())[0].is_infinite());
        let (n, sd) = (1001, 0.3);
        for k in 0..n {
            information.push(RowSVector::<f64, 2>::new(1.0, f64::from(k)) / sd);
        }
        let count = f64::from(n);
        let slope = sd / (count * (count * count - 1.0) / 12.0).sqrt();
        let end = sd * ((4.0 * count - 2.0) / (count * (count + 1.0))).sqrt();
        let at_end = SMatrix::<f64, 2, 2>::new(1.0, count - 1.0, 0.0, 1.0);
        let found = information.sd(&at_end);
        assert!((found[1] / slope - 1.0).abs() < 1e-12, "{found} {slope}");
        assert!((found[0] / end - 1.0).abs() < 1e-12, "{found} {end}");
    }

    #[test]
    fn prior_and_measurement_add_up() {
        let mut known = SquareRootInformation::prior(&SVector::<f64, 2>::new(3.0, 5.0));
        let mut measured = SquareRootInformation::new();
        measured.push(RowSVector::<f64, 2>::new(1.0, 0.0));
        known.merge(&measured, 1.0 / 4.0);
        let sd = known.sd(&SMatrix::identity());
        assert!((sd[0] - 2.4).abs() < 1e-12, "3 and 4 in parallel: {sd}");
        assert!((sd[1] - 5.0).abs() < 1e-12);
    }
}
