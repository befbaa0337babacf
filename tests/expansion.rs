//! The passes of the tensor basis for one surfel, facet or link each, against the light between
//! clusters of surfels as it is defined.

mod clouds;
mod clusters;

use clouds::{direction, random, rotation};
use clusters::{Cluster, colour, difference, vector, wide};
use fmmgi_gpu::expansion::{Indices, Link, Workspace, coefficients};
use fmmgi_gpu::math::Real;
use glam::{DQuat, DVec3};

/// The highest order tested.
const HIGHEST: usize = 12;

/// The ways from source to target.
#[derive(Clone, Copy, Debug)]
enum Way {
    /// P2M, M2L, L2P
    M2l,
    /// P2M to a child, M2M, M2L, L2L to a child, L2P
    Tree,
    /// P2L, L2P
    P2l,
    /// P2M, M2P
    M2p,
}

/// Light of one cluster at the places of another; radii of the expansions are `radius`.
fn transport<T: Real>(
    way: Way,
    order: usize,
    source: &Cluster,
    target: &Cluster,
    radius: f64,
) -> Vec<DVec3> {
    let indices = Indices::new(order);
    let mut workspace = Workspace::<T>::new(&indices);
    let zeros = || vec![T::Rgb::default(); coefficients(order)];
    let real = T::from_f64;
    let mut local = zeros();
    // The children of the tree are off the centre.
    let off = DVec3::new(0.2, -0.3, 0.1) * radius;
    let way_between = vector::<T>(target.centre - source.centre);
    match way {
        Way::M2l => {
            let moments = source.moments(&mut workspace, order, source.centre, radius);
            let scale = real(radius);
            workspace.m2l(
                order,
                &moments,
                way_between,
                [scale, scale],
                T::ONE,
                &mut local,
            );
        }
        Way::Tree => {
            let child = source.moments(&mut workspace, order, source.centre + off, 0.7 * radius);
            let (mut moments, mut above) = (zeros(), zeros());
            let place = vector::<T>(off / radius);
            workspace.m2m(&child, real(0.7), place, &mut moments);
            let scale = real(radius);
            workspace.m2l(
                order,
                &moments,
                way_between,
                [scale, scale],
                T::ONE,
                &mut above,
            );
            workspace.l2l(&above, real(0.6), place, &mut local);
            return target.lit(|(x, n)| {
                let place = vector::<T>((*x - target.centre - off) / (0.6 * radius));
                wide::<T>(workspace.l2p(&local, vector::<T>(*n), place))
            });
        }
        Way::P2l => {
            for ((y, n), f) in source.places.iter().zip(&source.normals).zip(&source.flux) {
                let way = vector::<T>(target.centre - *y);
                let flux = colour::<T>(*f);
                workspace.p2l(flux, vector::<T>(*n), way, real(radius), &mut local);
            }
        }
        Way::M2p => {
            let moments = source.moments(&mut workspace, order, source.centre, radius);
            return target.lit(|(x, n)| {
                let way = vector::<T>(*x - source.centre);
                wide::<T>(workspace.m2p(order, &moments, real(radius), way, vector::<T>(*n)))
            });
        }
    }
    target.lit(|(x, n)| {
        let place = vector::<T>((*x - target.centre) / radius);
        wide::<T>(workspace.l2p(&local, vector::<T>(*n), place))
    })
}

/// Light of some clusters by one link each, and by all side by side, in the order that they are done so in:
/// the same but for rounding.
fn side_by_side<T: Real>(links: usize) -> f64 {
    let order = 1;
    let indices = Indices::new(order);
    let mut workspace = Workspace::<T>::new(&indices);
    let mut rng = random(links as u64);
    let real = T::from_f64;
    let sources: Vec<(Vec<T::Rgb>, DVec3, f64, f64)> = (0..links)
        .map(|k| {
            let u = direction(&mut rng);
            let radius = 0.02 + 0.01 * k as f64;
            let source = Cluster::ball(&mut rng, DVec3::ZERO, u, radius, 10);
            let moments = source.moments(&mut workspace, order, source.centre, radius);
            (
                moments,
                u * (1.0 + 0.1 * k as f64),
                radius,
                1.0 / (1.0 + k as f64),
            )
        })
        .collect();
    let zeros = || vec![T::Rgb::default(); coefficients(order)];
    let (mut one_by_one, mut all) = (zeros(), zeros());
    let scale = real(0.1);
    for (moments, way, radius, part) in &sources {
        let (way, scales) = (vector::<T>(*way), [real(*radius), scale]);
        workspace.m2l(order, moments, way, scales, real(*part), &mut one_by_one);
    }
    let links = sources.iter().map(|(moments, way, radius, part)| Link {
        moments,
        way: vector::<T>(*way),
        scale: real(*radius),
        fraction: real(*part),
    });
    workspace.m2l_of_all(order, links, scale, &mut all);
    let [mut off, mut whole] = [0.0; 2];
    for (a, b) in all.iter().zip(&one_by_one) {
        let [a, b] = [*a, *b].map(|v| wide::<T>(v));
        off += a.distance_squared(b);
        whole += b.length_squared();
    }
    (off / whole).sqrt()
}

/// With any number of them: some lanes are left over.
#[test]
fn links_side_by_side_are_links_one_by_one() {
    for links in [1, 2, 7, 8, 9, 16, 29] {
        let [single, double] = [side_by_side::<f32>, side_by_side::<f64>].map(|of| of(links));
        assert!(
            single < 4.0 * f64::from(f32::EPSILON),
            "{links}: {single:e}"
        );
        assert!(double < 4.0 * f64::EPSILON, "{links}: {double:e}");
    }
}

const WAYS: [Way; 4] = [Way::M2l, Way::Tree, Way::P2l, Way::M2p];

/// Two clusters at distance 1 that face each other.
fn facing(seed: u64, radius: f64) -> (Cluster, Cluster) {
    let mut rng = random(seed);
    let u = direction(&mut rng);
    let source = Cluster::ball(&mut rng, DVec3::ZERO, u, radius, 30);
    let target = Cluster::ball(&mut rng, u, -u, radius, 30);
    (source, target)
}

fn exact(source: &Cluster, target: &Cluster) -> Vec<DVec3> {
    target.lit(|(x, n)| source.light(*x, *n))
}

/// An expansion of order p leaves terms of opening^(p+1): the error falls by about the opening with
/// every order, down to rounding.
#[test]
fn errors_fall_with_the_order_down_to_rounding() {
    for (opening, sides) in [(0.1, 2.0), (0.4, 2.0)] {
        let radius = opening / sides;
        let (source, target) = facing(1, radius);
        let wanted = exact(&source, &target);
        for way in WAYS {
            let error =
                |p| difference(&transport::<f64>(way, p, &source, &target, radius), &wanted);
            let errors: Vec<f64> = (0..=HIGHEST).map(error).collect();
            let shown: Vec<String> = errors.iter().map(|e| format!("{e:.1e}")).collect();
            println!("{opening} {way:?} {}", shown.join(" "));
            // Only one of both clusters is expanded by P2L and M2P.
            let theta: f64 = match way {
                Way::M2l | Way::Tree => opening,
                Way::P2l | Way::M2p => radius,
            };
            for (p, e) in errors.iter().enumerate() {
                let bound = (p as f64 + 2.0) * theta.powi(p as i32 + 1) + 1e-14;
                assert!(*e < bound, "{way:?} {p}: {e}, {bound}");
                let least = 1e-3 * theta.powi(p as i32 + 1) - 1e-15;
                assert!(*e > least, "{way:?} {p}: {e} is too good");
            }
        }
    }
}

/// Σ over the multi-indices of a polynomial's coefficients: moments and local expansions move
/// without error at every order.
#[test]
fn polynomials_move_exactly() {
    let mut rng = random(2);
    let (scale, centre) = (2.0, DVec3::new(0.3, -0.2, 0.5));
    for order in 0..=HIGHEST {
        let indices = Indices::new(order);
        let mut w = Workspace::<f64>::new(&indices);
        let zeros = vec![DVec3::ZERO; coefficients(order)];
        let (mut parent, mut whole) = (zeros.clone(), zeros.clone());
        for child_scale in [0.5, 0.7, 1.3] {
            let at = centre + direction(&mut rng);
            let axis = direction(&mut rng);
            let child = Cluster::ball(&mut rng, at, axis, 0.5, 20);
            let moments = child.moments(&mut w, order, at, child_scale);
            w.m2m(
                &moments,
                child_scale / scale,
                (at - centre) / scale,
                &mut parent,
            );
            for (sum, m) in whole
                .iter_mut()
                .zip(child.moments(&mut w, order, centre, scale))
            {
                *sum += m;
            }
        }
        assert!(difference(&parent, &whole) < 1e-13, "M2M {order}");

        let above: Vec<DVec3> = zeros.iter().map(|_| direction(&mut rng)).collect();
        let (ratio, place) = (0.6, DVec3::new(0.3, 0.2, -0.4));
        let mut below = zeros.clone();
        w.l2l(&above, ratio, place, &mut below);
        let [found, wanted]: [Vec<DVec3>; 2] = [true, false].map(|child| {
            let mut rng = random(3);
            (0..20)
                .map(|_| {
                    let (t, n) = (direction(&mut rng), direction(&mut rng));
                    match child {
                        true => w.l2p(&below, n, t),
                        false => w.l2p(&above, n, place + t * ratio),
                    }
                })
                .collect()
        });
        assert!(difference(&found, &wanted) < 1e-13, "L2L {order}");
    }
}

/// Coefficients of a lower order are the first of a higher one, by all passes to the same bits
/// except those that sum over more terms.
#[test]
fn lower_orders_come_first() {
    let (source, _) = facing(4, 0.2);
    let all = |order: usize, link: usize| {
        let indices = Indices::new(order);
        let mut w = Workspace::<f32>::new(&indices);
        let moments = source.moments(&mut w, order, source.centre, 0.2);
        let mut parent = vec![Default::default(); coefficients(order)];
        w.m2m(&moments, 0.7, vector::<f32>(DVec3::X), &mut parent);
        let mut local = vec![Default::default(); coefficients(order)];
        w.m2l(
            link,
            &moments,
            vector::<f32>(DVec3::Y),
            [0.2, 0.3],
            0.9,
            &mut local,
        );
        let near = vector::<f32>(DVec3::ONE);
        w.p2l(moments[0], near, near, 0.2, &mut parent);
        [moments, parent, local]
    };
    for order in 0..5 {
        let (low, high) = (all(order, order), all(6, order));
        for (a, b) in low.iter().zip(&high) {
            assert_eq!(a[..], b[..coefficients(order)], "{order}");
        }
        assert!(
            high[2][coefficients(order)..]
                .iter()
                .all(|c| c.to_array() == [0.0; 3])
        );
    }
}

/// f32 is f64 to rounding at every order and in every unit, about the origin of the map or far from
/// it: coefficients are scaled, places are relative.
#[test]
fn single_precision_keeps_its_digits_in_every_unit() {
    let (source, target) = facing(5, 0.2);
    for unit in [1e-4, 1.0, 1e5] {
        let [a, b] = [&source, &target].map(|c| c.moved(DQuat::IDENTITY, unit, DVec3::ZERO));
        for order in 0..=6 {
            for way in WAYS {
                let run = (
                    transport::<f32>(way, order, &a, &b, 0.2 * unit),
                    transport::<f64>(way, order, &a, &b, 0.2 * unit),
                );
                let off = difference(&run.0, &run.1);
                // Measured: 2e-7.
                assert!(off < 5e-7, "{unit} {way:?} {order}: {off:e}");
            }
        }
    }
}

/// ∂F_k/∂x_i by differences of a second M2L one step away: the local coefficients of an order are
/// the derivatives of those below.
#[test]
fn local_coefficients_are_derivatives() {
    let order = 5;
    let indices = Indices::new(order);
    let mut w = Workspace::<f64>::new(&indices);
    let (source, _) = facing(6, 0.1);
    // A point, so that no term is left out.
    let mut charge = vec![DVec3::ZERO; coefficients(order)];
    charge[1..4].copy_from_slice(&[source.flux[0], source.flux[1], source.flux[2]]);
    let mut at = |x: DVec3| {
        let mut local = vec![DVec3::ZERO; coefficients(order)];
        w.m2l(order, &charge, x, [1.0, 1.0], 1.0, &mut local);
        local
    };
    let x = DVec3::new(0.3, -0.5, 0.8);
    let step = 1e-5;
    let local = at(x);
    for (axis, e) in DVec3::AXES.into_iter().enumerate() {
        let (after, before) = (at(x + e * step), at(x - e * step));
        for (index, g) in indices.exponents().iter().enumerate() {
            let mut higher = *g;
            higher[axis] += 1;
            let Some(above) = indices.exponents().iter().position(|h| *h == higher) else {
                continue;
            };
            for k in 0..3 {
                let slope = (after[1 + 3 * index + k] - before[1 + 3 * index + k]) / (2.0 * step);
                let found = local[1 + 3 * above + k] * f64::from(higher[axis]);
                let off = (found - slope).length();
                assert!(
                    off < 1e-7 * (0.01 + slope.length()),
                    "{g:?} {axis} {k}: {off:e}"
                );
            }
        }
    }
}

/// F = curl curl of something: ∇·F = 0, and truncation keeps that.
#[test]
fn the_field_has_no_sources() {
    let order = 6;
    let indices = Indices::new(order);
    let mut w = Workspace::<f64>::new(&indices);
    let (source, _) = facing(7, 0.3);
    let moments = source.moments(&mut w, order, source.centre, 0.3);
    let mut local = vec![DVec3::ZERO; coefficients(order)];
    w.m2l(
        order,
        &moments,
        DVec3::new(0.5, 0.7, -0.3),
        [0.3, 0.4],
        1.0,
        &mut local,
    );
    for g in indices
        .exponents()
        .iter()
        .filter(|g| g.iter().sum::<u8>() < order as u8)
    {
        let mut sum = DVec3::ZERO;
        let mut size = 0.0;
        for i in 0..3 {
            let mut higher = *g;
            higher[i] += 1;
            let at = indices
                .exponents()
                .iter()
                .position(|h| *h == higher)
                .unwrap();
            let slope = local[1 + 3 * at + i] * f64::from(higher[i]);
            sum += slope;
            size += slope.length();
        }
        assert!(sum.length() < 1e-13 * size, "{g:?}: {sum} of {size}");
    }
}

/// All terms of a degree are kept, so that a rotation changes nothing, also at low orders.
#[test]
fn rotations_change_nothing() {
    let (source, target) = facing(8, 0.25);
    let turn = rotation(9);
    for order in [0, 1, 2, 3, 6] {
        for way in [Way::M2l, Way::P2l, Way::M2p] {
            let [a, b] = [&source, &target].map(|c| c.moved(turn, 1.0, DVec3::ZERO));
            let found = transport::<f64>(way, order, &a, &b, 0.25);
            let wanted = transport::<f64>(way, order, &source, &target, 0.25);
            let off = difference(&found, &wanted);
            assert!(off < 1e-13, "{way:?} {order}: {off:e}");
        }
    }
}

#[test]
fn colours_do_not_mix_and_fractions_multiply() {
    let (mut source, target) = facing(10, 0.2);
    let indices = Indices::new(3);
    let mut w = Workspace::<f64>::new(&indices);
    let mut light = |c: &Cluster, fraction: f64| {
        let moments = c.moments(&mut w, 3, c.centre, 0.2);
        let mut local = vec![DVec3::ZERO; coefficients(3)];
        w.m2l(
            3,
            &moments,
            target.centre - c.centre,
            [0.2, 0.2],
            fraction,
            &mut local,
        );
        w.l2p(&local, target.normals[0], DVec3::splat(0.3))
    };
    let white = light(&source, 1.0);
    let weak = light(&source, 0.25);
    assert!((weak - white * 0.25).length() < 1e-15 * white.length());
    source.flux.iter_mut().for_each(|f| f.y = 0.0);
    let pink = light(&source, 1.0);
    assert_eq!([pink.x, pink.y, pink.z], [white.x, 0.0, white.z]);
}
