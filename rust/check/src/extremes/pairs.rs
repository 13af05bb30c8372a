//! Pairs of directions at the edges of what they can be.

use glam::{DVec3, Vec3};

use super::{Family, Pair};

/// Cosines from the normal to the horizon: the last are the smallest normal number and denormals.
const COSINES: [f32; 17] = [
    1.0,
    0.999_999_9,
    0.999,
    0.5,
    0.1,
    1e-2,
    1e-3,
    1e-4,
    1e-5,
    1e-7,
    1e-10,
    1e-15,
    1e-20,
    1e-30,
    f32::MIN_POSITIVE,
    1e-42,
    1e-45,
];

/// Azimuths on the axes, between them, and where neither component is exact.
const AZIMUTHS: [f64; 5] = [0.0, 0.25, 0.7, std::f64::consts::FRAC_PI_2, 4.0];

/// Angles between the half vector and the normal, around the narrowest lobe.
const TILTS: [f64; 9] = [1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 3e-4, 1e-3, 1e-2, 0.1];

/// The direction of a cosine and an azimuth, rounded to float32.
pub fn direction(cos: f32, azimuth: f64) -> Vec3 {
    let z = f64::from(cos);
    let r = ((1.0 - z) * (1.0 + z)).sqrt();
    let v = DVec3::new(r * azimuth.cos(), r * azimuth.sin(), z).as_vec3();
    // The cosine as it is: rounding the vector must not move it.
    Vec3::new(v.x, v.y, cos)
}

/// `v` mirrored at the normal, exactly.
fn mirrored(v: Vec3) -> Vec3 {
    Vec3::new(-v.x, -v.y, v.z)
}

/// Directions of the whole hemisphere, evenly.
fn hemisphere(count: usize) -> Vec<Vec3> {
    // The R2 sequence (Roberts 2018).
    let point = |i: usize| {
        let i = i as f64 + 0.5;
        ((i * 0.754_877_666) % 1.0, (i * 0.569_840_291) % 1.0)
    };
    (0..count).map(point).map(|(z, phi)| direction(z as f32, phi * std::f64::consts::TAU)).collect()
}

/// The families of pairs.
#[must_use]
pub fn families() -> Vec<Family> {
    let family = |name, pairs| Family { name, pairs };
    vec![
        family("ordinary", ordinary()),
        family("grazing", grazing()),
        family("mirror pairs", mirror_pairs()),
        family("near mirror pairs", near_mirror_pairs()),
        family("light = view", retro_pairs()),
        family("light = -view", opposite_pairs()),
        family("no half vector", without_half_vector()),
        family("poles", poles()),
        family("lengths off by 1e-3", off_lengths()),
        family("denormals", denormals()),
        family("signed zeros", signed_zeros()),
        family("infinities", specials(&[f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN])),
        family("NaN", specials(&[f32::NAN, -f32::NAN])),
        family("no directions", no_directions()),
    ]
}

fn ordinary() -> Vec<Pair> {
    let directions = hemisphere(24);
    directions.iter().enumerate().map(|(i, &l)| (l, directions[(7 * i + 3) % 24])).collect()
}

fn grazing() -> Vec<Pair> {
    let mut pairs = Vec::new();
    for light in COSINES.map(|cos| direction(cos, 0.4)) {
        for view in
            COSINES.into_iter().zip(AZIMUTHS.into_iter().cycle()).map(|(cos, phi)| direction(cos, phi))
        {
            pairs.push((light, view));
        }
        pairs.push((light, Vec3::new(0.6, 0.8, 0.0)));
        pairs.push((Vec3::new(0.6, 0.8, 0.0), light));
    }
    pairs
}

fn mirror_pairs() -> Vec<Pair> {
    let views = COSINES.into_iter().flat_map(|cos| AZIMUTHS.map(|phi| direction(cos, phi)));
    views.map(|view| (mirrored(view), view)).collect()
}

fn near_mirror_pairs() -> Vec<Pair> {
    let mut pairs = Vec::new();
    for cos in [0.999_f32, 0.7, 0.1, 1e-2, 1e-4] {
        for tilt in TILTS {
            for phi in [0.0, 1.2] {
                let view = direction(cos, 0.3).as_dvec3();
                let half = DVec3::new(tilt.sin() * f64::cos(phi), tilt.sin() * f64::sin(phi), tilt.cos());
                let light = 2.0 * view.dot(half) * half - view;
                pairs.push((light.as_vec3(), view.as_vec3()));
            }
        }
    }
    pairs
}

fn retro_pairs() -> Vec<Pair> {
    let mut pairs = Vec::new();
    for view in COSINES.into_iter().flat_map(|cos| AZIMUTHS.map(|phi| direction(cos, phi))) {
        pairs.push((view, view));
        // The neighbour in float32.
        pairs.push((Vec3::new(view.x.next_up(), view.y, view.z), view));
        pairs.push((Vec3::new(view.x, view.y, view.z.next_down()), view));
    }
    pairs
}

fn opposite_pairs() -> Vec<Pair> {
    let mut pairs = Vec::new();
    for view in COSINES.into_iter().flat_map(|cos| AZIMUTHS.map(|phi| direction(cos, phi))) {
        pairs.push((-view, view));
        pairs.push((view, -view));
        // As nearly opposite as two directions above the horizon can be.
        for z in [1e-3, 1e-20, f32::MIN_POSITIVE, 1e-45] {
            pairs.push((Vec3::new(-view.x, -view.y, z), view));
        }
    }
    pairs
}

fn without_half_vector() -> Vec<Pair> {
    let mut pairs = Vec::new();
    for phi in AZIMUTHS {
        let horizon = Vec3::new(phi.cos() as f32, phi.sin() as f32, 0.0);
        // The sum is zero, or its square is.
        for z in [0.0, -0.0, 1e-45, f32::MIN_POSITIVE, 1e-30, 1e-23, 1e-19] {
            for w in [0.0, z, 2.0 * z, 1e-20] {
                pairs.push((horizon.with_z(z), (-horizon).with_z(w)));
            }
        }
    }
    pairs
}

fn poles() -> Vec<Pair> {
    let near = [1e-45, 1e-38, 1e-23, 1e-10, 1e-7, 1e-4].map(|x| Vec3::new(x, 0.0, 1.0));
    let mut views = vec![Vec3::Z, -Vec3::Z, Vec3::X, Vec3::Y, -Vec3::X, -Vec3::Y];
    views.extend(near);
    views.extend(near.map(|v| Vec3::new(0.0, -v.x, 1.0)));
    views.extend([Vec3::new(0.6, 0.0, 0.8), Vec3::new(0.0, 0.8, 0.6)]);
    views.iter().flat_map(|&l| views.iter().map(move |&v| (l, v))).collect()
}

fn off_lengths() -> Vec<Pair> {
    let mut pairs = Vec::new();
    for (l, v) in ordinary().into_iter().chain(mirror_pairs().into_iter().step_by(3)) {
        for (a, b) in [(1.001, 1.0), (1.0, 0.999), (1.001, 0.999), (0.999, 0.999)] {
            pairs.push((l * a, v * b));
        }
    }
    pairs
}

fn denormals() -> Vec<Pair> {
    let tiny = [1e-45, -1e-45, 1e-40, f32::MIN_POSITIVE, -1e-39];
    let mut views = Vec::new();
    for t in tiny {
        views.extend([
            Vec3::new(t, 0.6, 0.8),
            Vec3::new(t, t, 1.0),
            Vec3::new(1.0, t, t.abs()),
            Vec3::new(t, -1.0, t.abs()),
        ]);
    }
    views.iter().flat_map(|&l| views.iter().map(move |&v| (l, v))).collect()
}

fn signed_zeros() -> Vec<Pair> {
    let zeros = [0.0, -0.0];
    let mut views = Vec::new();
    for a in zeros {
        for b in zeros {
            views.extend([
                Vec3::new(a, b, 1.0),
                Vec3::new(1.0, a, b),
                Vec3::new(0.6, a, 0.8),
                Vec3::new(b, -0.6, 0.8),
            ]);
        }
    }
    views.iter().flat_map(|&l| views.iter().map(move |&v| (l, v))).collect()
}

/// Each value in each component of either direction.
fn specials(values: &[f32]) -> Vec<Pair> {
    let good = Vec3::new(0.48, 0.36, 0.8);
    let mut pairs = Vec::new();
    for &value in values {
        let mut broken = vec![Vec3::splat(value)];
        for component in 0..3 {
            let mut v = good;
            v[component] = value;
            broken.push(v);
        }
        for v in broken {
            pairs.extend([(v, good), (good, v), (v, v), (v, Vec3::Z)]);
        }
    }
    pairs
}

fn no_directions() -> Vec<Pair> {
    let good = Vec3::new(0.48, 0.36, 0.8);
    [0.0, 1e-45, 1e-20, 0.4, 2.1, 1e10, 3e38]
        .into_iter()
        .flat_map(|s| [(good * s, good), (good, good * s)])
        .collect()
}
