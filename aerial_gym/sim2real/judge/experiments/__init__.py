"""Design of experiments: the manoeuvre that distinguishes tied effects or shows an unseen one."""
