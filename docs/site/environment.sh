# To be sourced: the packages of docs/requirements.txt in a folder of their own, installed on first use.
list=$(readlink -f "$(dirname "${BASH_SOURCE[0]}")/../requirements.txt")
packages=${XDG_CACHE_HOME:-$HOME/.cache}/dolfinmpm/site-$({ python3 -V && cat "$list"; } | cksum | cut -d ' ' -f 1)
export PYTHONUSERBASE=$packages
if [[ ! -f $packages/complete ]]; then
    echo "installing the packages of docs/requirements.txt, once: half a minute, 800 MB; folder: $packages" >&2
    mkdir -p "$packages"
    (
        exec {lock}>"$packages/lock"
        flock "$lock"
        if [[ -f $packages/complete ]]; then exit; fi
        python3 -m pip install --user --quiet --break-system-packages --root-user-action=ignore \
            --no-warn-script-location -r "$list"
        touch "$packages/complete"
    )
fi
