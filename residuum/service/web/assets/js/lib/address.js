// The address of a page that keeps its view there.

// Gives what replaces the address as the view changes. Once the address leads elsewhere it is no longer this page's to change:
// between
// a link's press and the page that it opens, work that just then comes to its end would turn the way back.
export function keptAddress() {
  let own = location.hash;
  return (address) => {
    if (location.hash !== own) return;
    history.replaceState(null, "", address);
    own = location.hash;
  };
}
