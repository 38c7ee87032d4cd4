"""Commands that ``certpgo`` has in a checkout, one file each."""
