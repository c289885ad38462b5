# Every target is a command of do.py, which needs nothing but Python.
TARGETS := install demo test lint bench faults fuzz docs lock

.PHONY: $(TARGETS)
$(TARGETS):
	python3 do.py $@
