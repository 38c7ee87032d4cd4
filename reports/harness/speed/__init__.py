"""How fast certpgo is: whole processes, reading, solving, proving, sessions, beside other programs.

`measuring` runs steps in turn, the other modules say which, `pages` shows the records, and `bench`
has the list of everything.
"""
