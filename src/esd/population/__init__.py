"""Statistics of the shapes of a class: common connectivity, mean shape and principal modes."""
