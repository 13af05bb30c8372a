//! eval, pdf and sample allocate nothing, one by one and in batches: a renderer calls them from its
//! inner loop.

use std::alloc::{GlobalAlloc, Layout, System};
use std::ffi::CString;
use std::ptr;
use std::sync::atomic::{AtomicUsize, Ordering};

use glimt_check::extremes::materials_of_every_kind;
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

#[test]
fn nothing_is_allocated_after_loading() {
    const N: usize = 33;
    let folder = tempfile::tempdir().unwrap();
    let light = [-0.6f32, 0.0, 0.8].repeat(N);
    let view = [0.48f32, 0.36, 0.8].repeat(N);
    let (mut f, mut pdf) = (vec![0.0f32; 3 * N], vec![0.0f32; N]);
    let places = [glimt_place { u: 0.1, v: 0.7, dudx: 0.1, dvdx: 0.0, dudy: 0.0, dvdy: 0.01 }; N];
    let mut samples = vec![glimt_light_sample { light: [0.0; 3], pdf: 0.0, weight: [0.0; 3] }; N];
    for case in materials_of_every_kind() {
        let kind = case.material.kind();
        let path = case.save(&folder.path().join(kind.name())).unwrap();
        let path = CString::new(path.to_str().unwrap()).unwrap();
        let (mut library, mut material) = (ptr::null_mut(), ptr::null_mut());
        // SAFETY: every pointer is valid for what the functions read and write.
        unsafe {
            assert_eq!(glimt_library_open(path.as_ptr(), &mut library), glimt_status::GLIMT_OK);
            let opened = glimt_library_material(library, ptr::null(), &mut material);
            assert_eq!(opened, glimt_status::GLIMT_OK);
            glimt_library_close(library);

            let (l, v, p) = (light.as_ptr(), view.as_ptr(), places.as_ptr());
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
                glimt_eval_at(material, p, l, v, f.as_mut_ptr()),
                glimt_pdf_at(material, p, l, v, pdf.as_mut_ptr()),
                glimt_sample_at(material, p, v, l, samples.as_mut_ptr()),
                glimt_eval_at_batch(material, N, p, l, v, f.as_mut_ptr()),
            ];
            let allocated = ALLOCATIONS.load(Ordering::Relaxed) - before;
            assert_eq!(answers, [glimt_status::GLIMT_OK; 11]);
            assert_eq!(allocated, 0, "{kind}");
            glimt_material_release(material);
        }
        assert!(f[3 * N - 1] > 0.0 && pdf[N - 1] > 0.0 && samples[N - 1].pdf > 0.0, "{kind}");
    }
}
