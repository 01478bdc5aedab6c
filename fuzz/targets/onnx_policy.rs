//! An ONNX policy of anybody, for one mission or any. One that is read gives one displacement and a score per user for an
//! observation, and is read again as it was after it was written.
#![no_main]

use libfuzzer_sys::fuzz_target;
use trainer::onnx;

fuzz_target!(|data: &[u8]| {
    if let Ok((network, precision)) = onnx::sets::parse(data) {
        let again = onnx::sets::write(&network, precision).expect("it was read");
        let (again, _) = onnx::sets::parse(&again).expect("it was written");
        assert_eq!(again, network);
    }
    let Ok(actor) = onnx::read::parse(data) else {
        return;
    };
    let users = actor.provenance.users as usize;
    let observation = vec![0.0; actor.normalizer.offset.len()];
    let outputs = actor.evaluate(&observation);
    assert_eq!(outputs.len(), 2 + users);
    let parameters = actor
        .layers
        .iter()
        .flat_map(|layer| layer.weights.iter().chain(&layer.bias));
    let normalizer = actor
        .normalizer
        .offset
        .iter()
        .chain(&actor.normalizer.scale);
    // Beyond these, what is written, or what a network of many layers computes, may overflow.
    let moderate = |x: &f32| x.abs() < 1e6 && (*x == 0.0 || x.abs() > 1e-6);
    let largest = |values: &[f32]| values.iter().fold(0.0_f64, |most, x| most.max(x.abs().into()));
    let output = actor.layers.iter().fold(1e13, |input, layer| {
        input * layer.weights.len() as f64 * largest(&layer.weights) + largest(&layer.bias)
    });
    if output > 1e30 {
        return;
    }
    if parameters
        .chain(normalizer)
        .chain([&actor.reach_m])
        .all(moderate)
    {
        let again = onnx::read::parse(&onnx::write(&actor));
        let again = again.unwrap_or_else(|error| panic!("{error:#}"));
        assert_eq!(again.layers, actor.layers);
        assert_eq!(again.provenance, actor.provenance);
    }
});
