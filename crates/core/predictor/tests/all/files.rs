//! A model file is read as written, or refused with a reason.

use joulebus_predictor::{Activation, FeatureSet, INPUTS, ModelError, Network};
use joulebus_testkit_fleets::forged::{Contents, forged};
use joulebus_testkit_fleets::random::{Noise, card, network, parameters};
#[allow(dead_code)] // Each test file uses a part.
use joulebus_testkit_fleets::{exact, forged};

fn written(feature_set: FeatureSet) -> Vec<u8> {
    network(1, feature_set).to_safetensors().expect("valid networks can be written")
}

fn header_end(bytes: &[u8]) -> usize {
    8 + u64::from_le_bytes(bytes[..8].try_into().expect("eight bytes")) as usize
}

#[test]
fn a_network_is_read_from_its_file_bit_for_bit() {
    for feature_set in FeatureSet::ALL {
        let original = network(1, feature_set);
        let bytes = written(feature_set);
        let read = Network::from_safetensors(&bytes).expect("own files are read");
        assert_eq!(read.parameters(), original.parameters());
        assert_eq!(read.card(), original.card());
        assert_eq!(read.hash(), original.hash());
        assert_eq!(read.to_safetensors().expect("valid"), bytes);
    }
}

#[test]
fn the_hash_depends_on_weights_and_card() {
    let original = network(1, FeatureSet::Full).hash();
    let mut other = parameters(&mut Noise(1), FeatureSet::Full);
    other.layers[2].weights[5] += 1e-6;
    let other = Network::new(other, card(FeatureSet::Full)).expect("valid");
    assert_ne!(other.hash(), original);
    let mut renamed = card(FeatureSet::Full);
    renamed.name.push('!');
    let same = parameters(&mut Noise(1), FeatureSet::Full);
    assert_ne!(Network::new(same, renamed).expect("valid").hash(), original);
}

#[test]
fn every_truncation_is_refused() {
    let bytes = written(FeatureSet::PowerOnly);
    for length in 0..bytes.len() {
        assert!(Network::from_safetensors(&bytes[..length]).is_err(), "{length} bytes");
    }
    let mut longer = bytes;
    longer.push(0);
    assert!(Network::from_safetensors(&longer).is_err(), "one byte too many");
}

#[test]
fn every_flipped_bit_of_the_header_and_a_flipped_bit_in_every_byte_of_the_weights_is_refused() {
    let mut bytes = written(FeatureSet::PowerOnly);
    let header_end = header_end(&bytes);
    for position in 0..bytes.len() {
        let every_bit = (0..8).map(|bit| 1u8 << bit).chain([0xff]);
        let masks: Vec<u8> =
            if position < header_end { every_bit.collect() } else { vec![1 << (position % 8)] };
        for mask in masks {
            bytes[position] ^= mask;
            let refused = Network::from_safetensors(&bytes).is_err();
            assert!(refused, "byte {position} of {} with mask {mask:#x}", bytes.len());
            bytes[position] ^= mask;
        }
    }
}

fn contents() -> Contents {
    contents_of(FeatureSet::Full)
}

fn contents_of(set: FeatureSet) -> Contents {
    forged::contents(&written(set))
}

#[test]
fn a_rewritten_file_with_valid_contents_is_accepted() {
    let (metadata, tensors) = contents();
    let read = Network::from_safetensors(&forged(&metadata, &tensors)).expect("sound");
    assert_eq!(read.hash(), network(1, FeatureSet::Full).hash());
}

#[test]
fn a_file_that_does_not_state_the_rows_it_was_trained_on_is_read_as_unknown() {
    let (mut metadata, tensors) = contents();
    assert_eq!(
        metadata["trained_blocks"],
        "64:0000000000000003ffffffffffffffff;17:0000000000000000"
    );
    for field in ["trained_rows", "trained_blocks"] {
        metadata.remove(field);
    }
    let read = Network::from_safetensors(&forged(&metadata, &tensors)).expect("an older file");
    assert_eq!(read.card().trained_rows, None);
    assert_ne!(read.hash(), network(1, FeatureSet::Full).hash());
}

#[test]
fn a_file_without_an_energy_model_is_read_and_one_with_a_wrong_one_is_refused() {
    let (metadata, tensors) = contents();
    let mut older = metadata.clone();
    older.remove("energy");
    let read = Network::from_safetensors(&forged(&older, &tensors)).expect("an older file");
    assert_eq!(read.card().energy, None);
    for wrong in ["", "{}", "null", "[1,2]"] {
        let mut metadata = metadata.clone();
        metadata.insert("energy".to_owned(), wrong.to_owned());
        let error = Network::from_safetensors(&forged(&metadata, &tensors)).err();
        assert!(matches!(error, Some(ModelError::Energy(_))), "{wrong}: {error:?}");
    }
    let mut metadata = metadata.clone();
    let negative = metadata["energy"].replacen("\"mean_w\":", "\"mean_w\":-", 1);
    metadata.insert("energy".to_owned(), negative);
    let error = Network::from_safetensors(&forged(&metadata, &tensors)).err();
    assert!(matches!(error, Some(ModelError::Energy(_))), "{error:?}");
}

#[test]
fn the_activation_is_stored_and_changes_hash_and_forecast() {
    let row = [0.3; INPUTS];
    let mut parameters = parameters(&mut Noise(31), FeatureSet::Full);
    let seen = Activation::ALL.map(|activation| {
        parameters.activation = activation;
        let network = Network::new(parameters.clone(), card(FeatureSet::Full));
        let bytes = network.and_then(|network| network.to_safetensors());
        let read = Network::from_safetensors(&bytes.expect("valid")).expect("valid");
        assert_eq!(read.parameters().activation, activation);
        (read.hash(), exact::forecast_w(&read, &row).to_bits())
    });
    for (a, b) in [(0, 1), (1, 2), (0, 2)] {
        assert!(seen[a].0 != seen[b].0 && seen[a].1 != seen[b].1);
    }
}

#[test]
fn a_normalisation_that_overflows_the_folded_weights_is_refused() {
    let mut parameters = parameters(&mut Noise(32), FeatureSet::Full);
    parameters.normalisation.feature_std[2] = 1e-38;
    parameters.layers[0].weights[2] = 100.0;
    let error = Network::new(parameters, card(FeatureSet::Full)).err();
    let text = error.expect("refused").to_string();
    assert!(text.contains("folded into the first layer"), "{text}");
}

#[test]
fn wrong_metadata_is_refused_by_name() {
    for (field, value) in [
        ("format", "other"),
        ("format_version", "2"),
        ("kind", "forest"),
        ("activation", "tanh"),
        ("convention", "oldest first"),
        ("feature_set", "half"),
        ("features", "v_mps"),
        ("feature_mean", "1,2,3"),
        ("feature_mean", "1,2,3,4,5,6,7,8,9,10,NaN"),
        ("feature_std", "1,1,1,1,1,1,1,1,1,1,-1"),
        ("feature_std", "1,1,1,1,1,1,1,1,1,1,inf"),
        ("feature_std", "1,1,1,1,1,1,1,1,1,1,1e-45"),
        ("feature_min", "9,9,9,9,9,9,9,9,9,9,9"),
        ("power_mean_w", "inf"),
        ("power_std_w", "0"),
        ("power_std_w", "wide"),
        ("residual_std_w", "-1"),
        ("residual_q05_w", "7"),
        ("score_network_r2", "NaN"),
        ("score_rows", "-1"),
        ("seed", "seven"),
        ("name", "\x1b[2J"),
        ("name", &"a".repeat(129)),
        ("source", "one\r\ntwo"),
        ("training_data", &"a".repeat(65_537)),
        ("trained_rows", "many"),
        ("trained_blocks", "64"),
        ("trained_blocks", "0:0000000000000001"),
        ("trained_blocks", "64:000000000000001"),
        ("trained_blocks", "64:+00000000000001"),
        ("trained_blocks", "64:000000000000000g"),
        ("trained_blocks", "64:00000000000000020000000000000001"),
        ("trained_blocks", "-1:0000000000000001"),
    ] {
        let (mut metadata, tensors) = contents();
        metadata.insert(field.to_owned(), value.to_owned());
        let Err(error) = Network::from_safetensors(&forged(&metadata, &tensors)) else {
            panic!("`{field}` = {value} was accepted");
        };
        assert!(matches!(error, ModelError::Field { .. }), "{field}: {error}");
    }
    let (metadata, tensors) = contents();
    for field in metadata.keys().filter(|field| *field != "energy") {
        let mut metadata = metadata.clone();
        metadata.remove(field);
        let error = Network::from_safetensors(&forged(&metadata, &tensors)).err();
        let named =
            matches!(error, Some(ModelError::MissingField { field: named }) if named == field);
        assert!(named, "{field}: {error:?}");
    }
}

#[test]
fn a_file_states_the_features_read_and_the_definition_of_the_reading_age() {
    let of = |set| contents_of(set).0;
    let (paper, fresh) = (of(FeatureSet::Full), of(FeatureSet::Freshness));
    assert_eq!(paper["feature_set"], "full");
    assert_eq!(fresh["feature_set"], "freshness");
    let more = fresh["features"].strip_prefix(&paper["features"]);
    assert_eq!(more, Some(",reading_age_steps,reading_due"));
    let more = fresh["convention"].strip_prefix(&paper["convention"]);
    assert!(more.is_some_and(|more| more.contains("interval learned")), "{more:?}");
    assert!(!of(FeatureSet::PowerOnly)["convention"].contains("reading_due"));

    // A set with the feature list, definition or weights of another one is refused.
    for (set, other) in [
        (FeatureSet::Full, FeatureSet::Freshness),
        (FeatureSet::Freshness, FeatureSet::Full),
        (FeatureSet::PowerFreshness, FeatureSet::PowerOnly),
    ] {
        let (metadata, tensors) = contents_of(set);
        for field in ["feature_set", "features", "feature_mean"] {
            let mut metadata = metadata.clone();
            metadata.insert(field.to_owned(), of(other)[field].clone());
            let error = Network::from_safetensors(&forged(&metadata, &tensors)).err();
            assert!(matches!(error, Some(ModelError::Field { .. })), "{error:?}");
        }
        let error = Network::from_safetensors(&forged(&of(other), &tensors)).err();
        let text = error.expect("refused").to_string();
        let width = |set: FeatureSet| format!("F32 [64, {}]", set.inputs());
        assert!(text.contains(&width(set)) && text.contains(&width(other)), "{text}");
    }
}

#[test]
fn wrong_tensors_are_refused_by_name() {
    let with_value = |value: f32| {
        let (metadata, mut tensors) = contents();
        tensors[3].2[8..12].copy_from_slice(&value.to_le_bytes());
        Network::from_safetensors(&forged(&metadata, &tensors)).err()
    };
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let error = with_value(value);
        let named = matches!(&error, Some(ModelError::NotFinite { tensor, index: 2, .. })
            if tensor == "layers.1.weight");
        assert!(named, "{value}: {error:?}");
    }

    let (metadata, mut tensors) = contents();
    tensors[3].1 = vec![4096];
    let error = Network::from_safetensors(&forged(&metadata, &tensors)).err();
    assert!(matches!(error, Some(ModelError::Shape { .. })), "{error:?}");

    let (metadata, mut tensors) = contents();
    tensors.pop();
    let error = Network::from_safetensors(&forged(&metadata, &tensors)).err();
    assert!(matches!(error, Some(ModelError::MissingTensor { .. })), "{error:?}");

    let (metadata, mut tensors) = contents();
    tensors.push(("stranger".to_owned(), vec![1], vec![0; 4]));
    let error = Network::from_safetensors(&forged(&metadata, &tensors)).err();
    assert!(matches!(error, Some(ModelError::UnexpectedTensor { .. })), "{error:?}");
}

#[test]
fn a_file_of_another_size_class_is_refused_before_it_is_parsed() {
    let error = Network::from_safetensors(&vec![0; 2 << 20]).err();
    assert!(matches!(error, Some(ModelError::TooLarge { found: 2_097_152, .. })), "{error:?}");
}

#[test]
fn parameters_of_the_wrong_size_are_refused() {
    let mut wrong = parameters(&mut Noise(1), FeatureSet::Full);
    wrong.layers[0].bias.pop();
    let error = Network::new(wrong, card(FeatureSet::Full)).err();
    assert!(matches!(error, Some(ModelError::Shape { .. })), "{error:?}");
    let right = parameters(&mut Noise(1), FeatureSet::Full);
    let error = Network::new(right, card(FeatureSet::PowerOnly)).err();
    assert!(matches!(error, Some(ModelError::Field { .. })), "{error:?}");
}
