//! What kernels promise: the same bits for a pair however it comes, and right answers from every
//! instruction set.

use std::process::Command;
use std::sync::Arc;

use glam::{DVec3, Vec3};
use glimt_core::Brdf;
use glimt_core::directions::features::Inputs;
use glimt_core::kernels::ONE_MAX_RELATIVE_DIFFERENCE;
use glimt_core::kernels::network::{Activation, Layer, Network};
use glimt_core::microfacet::Microfacet;
use glimt_core::models::hybrid::{Form, Hybrid, reference};
use glimt_core::simd::{InstructionSet, isa_name};

fn material(inputs: Inputs, width: usize, layers: usize) -> Hybrid {
    let mut state = 7u32;
    let mut next = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32 - 0.5
    };
    let form = Form { inputs, ..Form::PAPER };
    let mut sizes = vec![width; layers + 2];
    sizes[0] = form.features() + 4;
    sizes[layers + 1] = 6;
    let layers = sizes
        .windows(2)
        .map(|w| Layer {
            weight: (0..w[0] * w[1]).map(|_| next() * 2.0 / (w[0] as f32).sqrt()).collect(),
            bias: (0..w[1]).map(|_| next()).collect(),
        })
        .collect();
    let network = Arc::new(Network::new(layers, form.features(), Activation::HardGelu).unwrap());
    let alpha = if inputs.is_isotropic() { [0.2; 2] } else { [0.2, 0.4] };
    let microfacet = Microfacet { kd: [0.3, 0.2, 0.1], eta: [1.5, 1.8, 2.5], alpha };
    Hybrid::new(form, network, microfacet, vec![0.1, -0.2, 0.3, 0.4], 2.0).unwrap()
}

fn materials() -> [Hybrid; 4] {
    [
        material(Inputs::Isotropic, 16, 3),
        material(Inputs::Cartesian, 32, 3),
        material(Inputs::AnisotropicReciprocal, 64, 2),
        // No multiple of any block of rows.
        material(Inputs::Anisotropic, 21, 2),
    ]
}

/// Pairs over the hemispheres and, every seventh, below the horizon or not a number.
fn pairs(n: usize) -> (Vec<Vec3>, Vec<Vec3>) {
    let direction = |u: f64, v: f64| {
        let (z, phi) = (0.03 + 0.97 * u.fract(), v.fract() * std::f64::consts::TAU);
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * phi.cos(), r * phi.sin(), z).as_vec3()
    };
    (0..n)
        .map(|i| {
            let t = i as f64 + 0.5;
            let (light, view) =
                (direction(t * 0.856_674_9, t * 0.733_891_9), direction(t * 0.628_706_7, t * 0.538_596_9));
            match i % 21 {
                6 => (-light, view),
                13 => (light, view.with_z(-0.1)),
                20 => (light.with_x(f32::NAN), view),
                _ => (light, view),
            }
        })
        .unzip()
}

fn bits(f: Vec3) -> [u32; 3] {
    f.to_array().map(f32::to_bits)
}

fn components(v: &[Vec3]) -> [Vec<f32>; 3] {
    [0, 1, 2].map(|c| v.iter().map(|v| v[c]).collect())
}

#[test]
fn pairs_have_the_same_bits_in_batches_and_packets_of_any_length_and_alignment() {
    let (light, view) = pairs(100);
    let (lights, views) = (components(&light), components(&view));
    for material in materials() {
        let mut all = vec![Vec3::ONE; light.len()];
        material.eval_batch(&light, &view, &mut all);
        assert!(all.iter().any(|f| f.max_element() > 0.0));
        for (start, length) in (0..5).flat_map(|start| (0..67).map(move |length| (start, length))) {
            let range = start..start + length;
            let mut batch = vec![Vec3::ONE; length];
            material.eval_batch(&light[range.clone()], &view[range.clone()], &mut batch);
            let mut packet = [0; 3].map(|_| vec![1.0; length]);
            material.eval_packet(
                lights.each_ref().map(|c| &c[range.clone()]),
                views.each_ref().map(|c| &c[range.clone()]),
                packet.each_mut().map(|c| &mut c[..]),
            );
            for i in 0..length {
                let expected = bits(all[start + i]);
                assert_eq!(bits(batch[i]), expected, "{length} from {start}, {}", isa_name());
                let f = Vec3::new(packet[0][i], packet[1][i], packet[2][i]);
                assert_eq!(bits(f), expected, "packet of {length} from {start}, {}", isa_name());
            }
        }
    }
}

#[test]
fn a_pair_alone_is_within_its_budget_of_the_same_in_a_batch_and_both_of_the_reference() {
    let (light, view) = pairs(2000);
    let mut largest = 0.0f32;
    for material in materials() {
        let mut batch = vec![Vec3::ONE; light.len()];
        material.eval_batch(&light, &view, &mut batch);
        for i in 0..light.len() {
            let one = material.eval(light[i], view[i]);
            if i % 7 == 6 {
                assert_eq!((one, batch[i]), (Vec3::ZERO, Vec3::ZERO));
                continue;
            }
            largest = largest.max((one - batch[i]).abs().max_element() / batch[i].max_element());
            let truth = reference::eval(&material, light[i].as_dvec3(), view[i].as_dvec3());
            for (f, truth) in batch[i].to_array().into_iter().zip(truth) {
                assert!((f64::from(f) - truth).abs() <= 5e-5 * truth, "{f} against {truth}, {}", isa_name());
            }
        }
    }
    println!("largest difference {} ULP, {}", largest / f32::EPSILON, isa_name());
    assert!(largest <= ONE_MAX_RELATIVE_DIFFERENCE, "{} ULP, {}", largest / f32::EPSILON, isa_name());
}

#[test]
fn every_instruction_set_of_this_machine_keeps_the_promises() {
    let itself = std::env::current_exe().unwrap();
    for set in InstructionSet::ALL.into_iter().filter(|set| set.is_available()) {
        let output = Command::new(&itself)
            .args(["pairs_have_the_same_bits", "a_pair_alone_is_within"])
            .env("GLIMT_ISA", set.name())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success() && said.contains("2 passed"), "{}: {said}", set.name());
    }
}
