"""Methods that search and certify, found by file name like those of `certpgo.optimize.methods`."""
