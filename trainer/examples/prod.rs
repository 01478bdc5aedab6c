use std::time::Instant;
use trainer::nn::product::*;
fn main() {
    let arch = pulp::Arch::new();
    for (name, m, k, n, t) in [
        ("fwd128", 128, 128, 64, false),
        ("fwd21", 128, 21, 64, false),
        ("fwd_out", 15, 128, 64, false),
        ("dX", 128, 128, 64, true),
        ("dXout", 128, 15, 64, true),
        ("dW128", 128, 64, 128, false),
        ("dW21", 128, 64, 32, false),
        ("dWout", 15, 64, 128, false),
        ("fwd16", 128, 128, 16, false),
    ] {
        let a: Vec<f32> = (0..m * k).map(|i| (i as f32 * 0.37).sin()).collect();
        let b: Vec<f32> = (0..n * k).map(|i| (i as f32 * 0.73).sin()).collect();
        let mut c = vec![0f32; n * m];
        let g = c.clone();
        let left = if t {
            Left::transposed(&a, m, m)
        } else {
            Left::rows(&a, m, k)
        };
        let mut best = f64::MAX;
        for _ in 0..20 {
            let s = Instant::now();
            for _ in 0..1000 {
                product(
                    arch,
                    left,
                    &b,
                    &mut c,
                    k,
                    n,
                    if t {
                        Epilogue::WherePositive(&g)
                    } else {
                        Epilogue::BiasRelu(&g)
                    },
                );
            }
            best = best.min(s.elapsed().as_secs_f64() / 1000.0);
        }
        println!(
            "{name} {:.2} us {:.1} GF",
            best * 1e6,
            2.0 * (m * n * k) as f64 / best / 1e9
        );
    }
    let from = vec![1f32; 128 * 64];
    let mut to = vec![0f32; 128 * 64];
    let s = Instant::now();
    for _ in 0..10000 {
        transpose(arch, &from, &mut to, 128, 64, 64, 128);
    }
    println!("transpose {:.2} us", s.elapsed().as_secs_f64() * 100.0);
    let mut adam = trainer::nn::Adam::new(22000);
    let mut p = vec![0.1; 22000];
    let g = vec![0.01; 22000];
    let s = Instant::now();
    for _ in 0..1000 {
        adam.step(arch, 1e-4, &mut p, &g);
    }
    println!("adam {:.2} us", s.elapsed().as_secs_f64() * 1000.0);
}
