//! eval, pdf and sample allocate nothing, one by one and in batches: a renderer calls them from its
//! inner loop.

use std::alloc::{GlobalAlloc, Layout, System};
use std::ffi::CString;
use std::ptr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use glimt_core::features::Inputs;
use glimt_core::ggx::Ggx;
use glimt_core::hybrid::{Form, Hybrid};
use glimt_core::library::{Entry, Origin};
use glimt_core::microfacet::Microfacet;
use glimt_core::nbrdf::Nbrdf;
use glimt_core::network::{Activation, Layer, Network};
use glimt_core::neural::{Neural, Shared};
use glimt_core::{Library, Material};
use glimt_ffi::c_api::*;

/// The system's allocator, counting.
struct Counting;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

// SAFETY: the system's allocator does it all.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn network(sizes: &[usize], features: usize, activation: Activation) -> Arc<Network> {
    let layers = sizes.windows(2).map(|pair| Layer {
        weight: (0..pair[0] * pair[1]).map(|i| 0.3 * (i as f32 * 1.7).sin()).collect(),
        bias: vec![0.05; pair[1]],
    });
    Arc::new(Network::new(layers.collect(), features, activation).unwrap())
}

/// A material of every model.
fn materials() -> Vec<Material> {
    let microfacet = Microfacet { kd: [0.3, 0.2, 0.1], eta: [1.5; 3], alpha: [0.2; 2] };
    let form = Form { inputs: Inputs::Isotropic, ..Form::PAPER };
    let hybrid = network(&[form.features() + 4, 32, 32, 6], form.features(), Activation::HardGelu);
    let shared = Shared {
        network: Arc::unwrap_or_clone(network(&[18 + 8, 32, 32, 3], 18, Activation::HardGelu)),
        frames: Layer { weight: vec![0.1; 18 * 8], bias: vec![0.1; 18] },
    };
    vec![
        Material::from(Ggx::new(microfacet).unwrap()),
        Material::from(Hybrid::new(form, hybrid, microfacet, vec![0.1; 4], 1.0).unwrap()),
        Material::from(Neural::new(Arc::new(shared), vec![0.1; 8], 1.0).unwrap()),
        Material::from(Nbrdf::new(network(&[6, 21, 21, 3], 6, Activation::Relu)).unwrap()),
    ]
}

#[test]
fn nothing_is_allocated_after_loading() {
    const N: usize = 33;
    let folder = tempfile::tempdir().unwrap();
    let light = [-0.6f32, 0.0, 0.8].repeat(N);
    let view = [0.48f32, 0.36, 0.8].repeat(N);
    let (mut f, mut pdf) = (vec![0.0f32; 3 * N], vec![0.0f32; N]);
    let mut samples = vec![glimt_light_sample { light: [0.0; 3], pdf: 0.0, weight: [0.0; 3] }; N];
    for material in materials() {
        let kind = material.kind();
        let path = folder.path().join(kind);
        let entry = Entry { name: "only".into(), material, origin: Origin::default() };
        Library::new(&path, vec![entry]).unwrap().save().unwrap();
        let path = CString::new(path.to_str().unwrap()).unwrap();
        let (mut library, mut material) = (ptr::null_mut(), ptr::null_mut());
        // SAFETY: every pointer is valid for what the functions read and write.
        unsafe {
            assert_eq!(glimt_library_open(path.as_ptr(), &mut library), glimt_status::GLIMT_OK);
            let opened = glimt_library_material(library, ptr::null(), &mut material);
            assert_eq!(opened, glimt_status::GLIMT_OK);
            glimt_library_close(library);

            let (l, v) = (light.as_ptr(), view.as_ptr());
            // The first density makes the sampler.
            assert_eq!(glimt_pdf(material, l, v, pdf.as_mut_ptr()), glimt_status::GLIMT_OK);
            let before = ALLOCATIONS.load(Ordering::Relaxed);
            let answers = [
                glimt_eval(material, l, v, f.as_mut_ptr()),
                glimt_pdf(material, l, v, pdf.as_mut_ptr()),
                glimt_sample(material, v, l, samples.as_mut_ptr()),
                glimt_eval_batch(material, N, l, v, f.as_mut_ptr()),
                glimt_pdf_batch(material, N, l, v, pdf.as_mut_ptr()),
                // The lights are no random numbers: one below 0 fails, which allocates nothing either.
                glimt_sample_batch(material, N, v, l, samples.as_mut_ptr()),
                glimt_sample_batch(material, N, v, v, samples.as_mut_ptr()),
            ];
            let allocated = ALLOCATIONS.load(Ordering::Relaxed) - before;
            assert_eq!(answers, [glimt_status::GLIMT_OK; 7]);
            assert_eq!(allocated, 0, "{kind}");
            glimt_material_release(material);
        }
        assert!(f[3 * N - 1] > 0.0 && pdf[N - 1] > 0.0 && samples[N - 1].pdf > 0.0, "{kind}");
    }
}
