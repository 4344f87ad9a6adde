//! Minimisation of a smooth function of a few variables.

use nalgebra::{DMatrix, DVector};

/// A point, the value there and the gradient there.
pub type Evaluated = (f64, DVector<f64>);

/// Minimises with BFGS from `start`; returns the point and the value there, `(x, f(x))`.
///
/// ```text
/// p = -H g          x' = x + a p, a halved from 1 until f(x') <= f(x) + 1e-4 a g.p
/// H' = (I - r s y^T) H (I - r y s^T) + r s s^T,   s = x' - x, y = g' - g, r = 1 / y.s   (only if y.s > 0)
/// ```
///
/// | argument | meaning |
/// |----------|---------|
/// | `f` | value and gradient at a point; not finite where undefined, which the line search steps away from |
/// | `start` | first point, shape `[n]` |
/// | `step_max` | longest move of one coordinate in one iteration |
/// | `iterations` | most iterations; ends sooner when no coordinate of the gradient exceeds 1e-5 |
///
/// Deterministic. Never returns a point worse than `start`.
///
/// Source: Nocedal, Wright, Numerical Optimization (2006), algorithm 6.1 with the backtracking of
/// algorithm 3.1.
pub fn minimise(
    mut f: impl FnMut(&DVector<f64>) -> Evaluated,
    start: DVector<f64>,
    step_max: f64,
    iterations: usize,
) -> (DVector<f64>, f64) {
    let n = start.len();
    let (mut value, mut gradient) = f(&start);
    let mut x = start;
    let mut inverse_hessian = DMatrix::identity(n, n);
    for _ in 0..iterations {
        if gradient.amax() < 1e-5 || !value.is_finite() {
            break;
        }
        let mut direction = -(&inverse_hessian * &gradient);
        if direction.dot(&gradient) >= 0.0 {
            // Rounding has spoilt the curvature estimate: restart from steepest descent.
            inverse_hessian = DMatrix::identity(n, n);
            direction = -gradient.clone();
        }
        direction *= (step_max / direction.amax()).min(1.0);
        let Some((moved, next)) = backtrack(&mut f, &x, value, &gradient, &direction) else {
            break;
        };
        inverse_hessian = updated(inverse_hessian, &moved - &x, &next.1 - &gradient);
        (x, value, gradient) = (moved, next.0, next.1);
    }
    (x, value)
}

/// Returns the first of `x + direction / 2^k` with sufficient decrease, or `None` after 25
/// halvings.
fn backtrack(
    f: &mut impl FnMut(&DVector<f64>) -> Evaluated,
    x: &DVector<f64>,
    value: f64,
    gradient: &DVector<f64>,
    direction: &DVector<f64>,
) -> Option<(DVector<f64>, Evaluated)> {
    let slope = gradient.dot(direction);
    (0..25).map(|halvings| 0.5f64.powi(halvings)).find_map(|a| {
        let moved = x + direction * a;
        let next = f(&moved);
        let sound = next.0.is_finite() && next.1.iter().all(|g| g.is_finite());
        (sound && next.0 <= value + 1e-4 * a * slope).then_some((moved, next))
    })
}

fn updated(inverse_hessian: DMatrix<f64>, s: DVector<f64>, y: DVector<f64>) -> DMatrix<f64> {
    let curvature = y.dot(&s);
    if curvature <= 1e-10 * s.norm() * y.norm() {
        return inverse_hessian;
    }
    let n = s.len();
    let left = DMatrix::identity(n, n) - &s * y.transpose() / curvature;
    &left * inverse_hessian * left.transpose() + &s * s.transpose() / curvature
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rosenbrock(x: &DVector<f64>) -> Evaluated {
        let (a, b) = (x[0], x[1]);
        let value = (1.0 - a).powi(2) + 100.0 * (b - a * a).powi(2);
        (
            value,
            DVector::from_vec(vec![
                -2.0 * (1.0 - a) - 400.0 * a * (b - a * a),
                200.0 * (b - a * a),
            ]),
        )
    }

    #[test]
    fn the_banana_valley_is_followed_to_its_end() {
        let (x, value) = minimise(rosenbrock, DVector::from_vec(vec![-1.2, 1.0]), 1.0, 200);
        assert!(
            (x[0] - 1.0).abs() < 1e-4 && (x[1] - 1.0).abs() < 1e-4 && value < 1e-9,
            "{x} {value}"
        );
    }

    #[test]
    fn a_step_into_undefined_ground_is_taken_back() {
        // x - ln x, undefined for x <= 0; the first full step from 10 lands there.
        let f = |x: &DVector<f64>| (x[0] - x[0].ln(), x.map(|x| 1.0 - 1.0 / x));
        let (x, _) = minimise(f, DVector::from_vec(vec![10.0]), 100.0, 100);
        assert!((x[0] - 1.0).abs() < 1e-4);
        let nowhere = |x: &DVector<f64>| (f64::NAN, x.clone());
        assert_eq!(minimise(nowhere, DVector::from_vec(vec![2.0]), 1.0, 10).0[0], 2.0);
    }
}
