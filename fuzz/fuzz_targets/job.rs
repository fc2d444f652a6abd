//! A job file: what is read and sound survives being written.
#![no_main]

use splatprobe::job::Job;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let path = splatprobe_fuzz::file("job.json", bytes);
    let Ok(job) = Job::from_file(&path) else { return };
    if job.validate().is_ok() {
        let text = serde_json::to_vec(&job).expect("a job is JSON");
        splatprobe_fuzz::file("job.json", &text);
        assert_eq!(Job::from_file(&path).expect("its own JSON is read"), job);
    }
});
