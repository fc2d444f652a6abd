"""Bakes reflection probes as a build action."""

def _splatprobe_bake_impl(ctx):
    output = ctx.actions.declare_directory(ctx.label.name)
    ctx.actions.run(
        executable = ctx.executable.splatprobe,
        # Bazel keeps results by their inputs itself, and a folder of its own for every action.
        arguments = ["bake", ctx.file.job.path, "-o", output.path, "--no-cache", "--progress", "none"],
        inputs = depset([ctx.file.job] + ctx.files.data),
        outputs = [output],
        mnemonic = "SplatprobeBake",
        progress_message = "Baking %{label}",
        # Another instruction level rounds differently: a remote cache must not mix machines.
        execution_requirements = {"no-remote-cache": "1"} if ctx.attr.machine_dependent else {},
    )
    return [DefaultInfo(files = depset([output]))]

splatprobe_bake = rule(
    implementation = _splatprobe_bake_impl,
    doc = "Bakes a job to a folder with manifest.json and a folder for every probe.",
    attrs = {
        "job": attr.label(allow_single_file = [".json"], mandatory = True, doc = "The job."),
        "data": attr.label_list(allow_files = True, doc = "Everything that the job names: Bazel shows the action nothing else."),
        "splatprobe": attr.label(executable = True, cfg = "exec", mandatory = True, doc = "The program."),
        "machine_dependent": attr.bool(
            default = True,
            doc = "Whether executors differ in their instruction levels (AVX2, AVX-512), so that results are kept locally.",
        ),
    },
)
