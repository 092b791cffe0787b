#![cfg_attr(fuzzing, no_main)]
joulebus_fuzz::program!("ros");
