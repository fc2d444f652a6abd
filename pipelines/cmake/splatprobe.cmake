# splatprobe_add_bake(<target> JOB <job.json> OUTPUT <folder>)
#
# Bakes the job to the folder when the target is built and an input has changed. Needs CMake 3.20 (depfiles with Makefiles
# and Ninja). Set SPLATPROBE to the program where it is not on the path, SPLATPROBE_CACHE to share results.

find_program(SPLATPROBE splatprobe)
set(SPLATPROBE_CACHE "${CMAKE_BINARY_DIR}/splatprobe-cache" CACHE PATH "Folder in which results of bakes are kept")

function(splatprobe_add_bake target)
  cmake_parse_arguments(PARSE_ARGV 1 BAKE "" "JOB;OUTPUT" "")
  if(NOT BAKE_JOB OR NOT BAKE_OUTPUT)
    message(FATAL_ERROR "splatprobe_add_bake(${target}): give JOB and OUTPUT")
  endif()
  get_filename_component(job "${BAKE_JOB}" ABSOLUTE)
  get_filename_component(output "${BAKE_OUTPUT}" ABSOLUTE BASE_DIR "${CMAKE_CURRENT_BINARY_DIR}")
  add_custom_command(
    OUTPUT "${output}/manifest.json"
    COMMAND "${SPLATPROBE}" bake "${job}" -o "${output}" --cache "${SPLATPROBE_CACHE}"
            --depfile "${output}.d" --progress none
    DEPENDS "${job}"
    DEPFILE "${output}.d"
    COMMENT "Baking ${target}"
    VERBATIM)
  add_custom_target(${target} ALL DEPENDS "${output}/manifest.json")
endfunction()
