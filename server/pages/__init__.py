"""The pages people see: HTML rendered on the server, complete without JavaScript."""
