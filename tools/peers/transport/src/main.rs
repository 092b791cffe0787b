fn main() { println!("{:?}", zenoh::Config::default()); }
