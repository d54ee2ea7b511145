"""States and torques in the conventions of others: by joint name, and as MuJoCo has them."""
