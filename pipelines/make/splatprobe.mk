# How Make bakes probes: include this file, and `make out/room/manifest.json` bakes room.json.
#
# Make learns the inputs that a job names from the depfile of the bake before.

SPLATPROBE ?= splatprobe
SPLATPROBE_CACHE ?= out/.splatprobe-cache

out/%/manifest.json: %.json
	$(SPLATPROBE) bake $< -o $(@D) --cache $(SPLATPROBE_CACHE) --depfile $(@D).d --progress none

-include $(wildcard out/*.d)
