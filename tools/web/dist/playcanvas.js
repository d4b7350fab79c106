/*! cogsplat, Apache-2.0 */
var M=new Uint32Array(1),O=new Float32Array(M.buffer);function g(e){O[0]=e;let n=M[0]>>>16&32768,t=Math.min(Math.abs(e),65504);if(t<2**-14)return n|Math.round(t*2**24);O[0]=t;let o=M[0];return n|o+4095+(o>>>13&1)-939524096>>>13}function w(e){let n=e&32768?-1:1,t=e>>>10&31,o=e&1023;return n*(t===0?o*2**-24:(1024+o)*2**(t-25))}function S(e,n){let t=e*Math.exp(n);return t/(t+1-e)}var H=e=>({name:e,width:4,bytes:2}),m=(e,n=4)=>({name:e,width:n,bytes:4}),y=[H("dcColor"),m("transformA"),H("transformB")],B=[y,[...y,m("splatSH_1to3")],[...y,m("splatSH_1to3"),m("splatSH_4to7"),m("splatSH_8to11",1)],[...y,m("splatSH_1to3"),m("splatSH_4to7"),m("splatSH_8to11"),m("splatSH_12to15")]];var it=Math.log(65504);function D({arrays:e,count:n},t,o,c){let[i,,a]=e,[s,,f]=o;for(let r=0;r<n;r++){let l=4*(c+r);s[l+3]=g(S(w(i[4*r+3]),t.opacities[r]));let h=Math.exp(t.scales[r]);for(let p=0;p<3;p++)f[l+p]=g(w(a[4*r+p])*h)}}var b=(...e)=>e.map(n=>({name:n,width:4,bytes:4})),E=[b("centers","shapes"),b("centers","shapes","sh1"),b("centers","shapes","sh1","sh2"),b("centers","shapes","sh1","sh2","sh3a","sh3b")];function F({arrays:e,count:n},t,o,c){let[i,a]=e,[s,f]=o;for(let r=0;r<n;r++){let l=4*(c+r),h=p=>g(w(p)+t.scales[r]);s[l+3]=g(S(w(i[4*r+3]),t.opacities[r])),f[l+1]=a[4*r+1]&65535|h(a[4*r+1]>>>16)<<16,f[l+2]=h(a[4*r+2]&65535)|h(a[4*r+2]>>>16)<<16}}var Y=new Float32Array(1),pt=new Uint32Array(Y.buffer);function k(e,n){return(e==="spark"?E:B)[n]}function U(e,n,t){return Q(k(e,n),t)}function Q(e,n){return e.map(({width:t,bytes:o})=>o===4?new Uint32Array(t*n):new Uint16Array(t*n))}function G(e,n,t,o){let{arrays:c,count:i,layout:a}=e;c.forEach((s,f)=>t[f].set(s,s.length/i*o)),n!==void 0&&(a==="spark"?F:D)(e,n,t,o)}var Z={R:"L",L:"R",U:"D",D:"U",F:"B",B:"F"};function C(e,n="RUB"){return[...n].flatMap(t=>[...e].map(o=>o===t?1:o===Z[t]?-1:0))}function I(e,n="RUB"){let t=C(e,n);if(t[0]*(t[4]*t[8]-t[5]*t[7])-t[1]*(t[3]*t[8]-t[5]*t[6])+t[2]*(t[3]*t[7]-t[4]*t[6])<0)throw new RangeError(`axes ${e} are a reflection of ${n}`);let c=[1+t[0]-t[4]-t[8],1-t[0]+t[4]-t[8],1-t[0]-t[4]+t[8],1+t[0]+t[4]+t[8]],i=c.indexOf(Math.max(...c)),a=Math.sqrt(c[i]),s=.5/a;switch(i){case 0:return[a/2,(t[1]+t[3])*s,(t[2]+t[6])*s,(t[7]-t[5])*s];case 1:return[(t[1]+t[3])*s,a/2,(t[5]+t[7])*s,(t[2]-t[6])*s];case 2:return[(t[2]+t[6])*s,(t[5]+t[7])*s,a/2,(t[3]-t[1])*s];default:return[(t[7]-t[5])*s,(t[2]-t[6])*s,(t[3]-t[1])*s,a/2]}}function z(e,n){let t=e;for(let[o,c]of n){if(!t.includes(o))return;t=t.replaceAll(o,c)}return t}function V(e){return Number.isInteger(e)?`${e}.0`:String(e)}var tt=250,et=6;function P(e,n){return Math.min(n.degree??e.info.shDegree,e.info.shDegree)}async function N(e,n,t,o,c){let i=o.compensate??!0,a=new R(e,t,i),s=new T,f=-1/0,r=e.stream({...o,degree:P(e,o),compensate:i,format:n,signal:c});for await(let l of r)a.put(l.chunk,{texels:l.texels,firstRow:l.firstRow},l.prefix),await s.rest(),!(performance.now()-f<(o.uploadInterval??tt))&&(await a.show(s),o.onUpload?.(a.shown),f=performance.now());await a.show(s),o.onUpload?.(a.shown)}function W(e,n,t){return U(n,t,e.info.splats)}var R=class{scene;target;compensate;shown=0;rows=0;prefix=0;chunks=new Map;fresh=new Set;shownPrefix=-1;constructor(n,t,o){this.scene=n,this.target=t,this.compensate=o}put(n,t,o){this.chunks.set(n,t),this.fresh.add(n),this.rows=Math.max(this.rows,t.firstRow+t.texels.count),this.prefix=o}async show(n){let t=this.prefix,o=this.compensate&&t!==this.shownPrefix?[...this.chunks.keys()]:[...this.fresh];if(o.length!==0){for(let c of o){let{texels:i,firstRow:a}=this.chunks.get(c),s=this.compensate&&c<t?this.scene.compensation.shifts(t,c):void 0;G(i,s,this.target.arrays,a),await n.rest()}this.fresh.clear(),this.shownPrefix=t,this.shown=this.rows,(!this.compensate||t===this.scene.index.totalChunkCount)&&this.chunks.clear(),this.target.upload(this.rows)}}},T=class{since=performance.now();async rest(){performance.now()-this.since<et||(await new Promise(n=>setTimeout(n,0)),this.since=performance.now())}};function q(e){let n=new AbortController;return e?.aborted?n.abort(e.reason):e?.addEventListener("abort",()=>n.abort(e.reason),{once:!0}),n}function J(e,{worldOrigin:n}){let t=e.info.origin.map((c,i)=>c-(n??e.info.origin)[i]),o=C(e.info.axes);return[0,1,2].map(c=>t.reduce((i,a,s)=>i+o[3*c+s]*a,0))}function _t(e,n,{info:t}){let{gsplat:o}=n.scene;o.minPixelSize=0,o.antiAlias=t.antialiased;let c=e.ShaderChunks.get(n.graphicsDevice,"glsl"),i=V(4*t.kernelPx),a={gsplatPS:[["normExp(A) * gaussianColor.a","min(0.99, exp(A * -4.0) * gaussianColor.a)"],["if (A > 1.0)","if (A > 1.4)"]],gsplatCommonVS:[["float clip = min(1.0, sqrt(max(0.0, log(alpha / alphaClipValue))) * 0.5);","float clip = sqrt(max(0.0, log(alpha / alphaClipValue))) * 0.5;"]],gsplatCornerVS:[["+ 0.3",`+ ${i}`],["vec2 J2 = -J1 / vp.z * vp.xy;","vec2 edge = 1.3 / vec2(center.projMat00, abs(center.projMat11)); vec2 J2 = -J1 * clamp(vp.xy / vp.z, -edge, edge);"],["min(1024.0, min(viewport_size.x, viewport_size.y))","1e6"]]},s=Object.entries(a).map(([f,r])=>[f,z(c.get(f)??"",r)]);if(s.some(([,f])=>f===void 0))return!1;for(let[f,r]of s)o.material.getShaderChunks("glsl").set(f,r);return!0}var nt=`
uint cogsRotation;
vec4 cogsScale;
vec3 getCenter() {
  uvec4 transform = loadTransformA();
  cogsRotation = transform.w;
  cogsScale = loadTransformB();
  return uintBitsToFloat(transform.xyz);
}
vec4 getColor() { return loadDcColor(); }
vec3 getScale() { return cogsScale.xyz; }
vec4 getRotation() {
  vec3 s = (vec3((uvec3(cogsRotation) >> uvec3(0u, 10u, 20u)) & 1023u) / 511.5 - 1.0) * 0.70710678;
  float rest = sqrt(max(0.0, 1.0 - dot(s, s)));
  uint largest = cogsRotation >> 30u;
  if (largest == 0u) return vec4(rest, s);
  if (largest == 1u) return vec4(s.x, rest, s.yz);
  return largest == 2u ? vec4(s.xy, rest, s.z) : vec4(s, rest);
}
#include "gsplatUncompressedSHVS"
`,ot=`
var<private> cogsRotation: u32;
var<private> cogsScale: vec4f;
fn getCenter() -> vec3f {
  let transform: vec4<u32> = loadTransformA();
  cogsRotation = transform.w;
  cogsScale = loadTransformB();
  return bitcast<vec3f>(transform.xyz);
}
fn getColor() -> vec4f { return loadDcColor(); }
fn getScale() -> vec3f { return cogsScale.xyz; }
fn getRotation() -> vec4f {
  let s = (vec3f((vec3u(cogsRotation) >> vec3u(0u, 10u, 20u)) & vec3u(1023u)) / 511.5 - 1.0) * 0.70710678;
  let rest = sqrt(max(0.0, 1.0 - dot(s, s)));
  let largest = cogsRotation >> 30u;
  if (largest == 0u) { return vec4f(rest, s); }
  if (largest == 1u) { return vec4f(s.x, rest, s.yz); }
  if (largest == 2u) { return vec4f(s.xy, rest, s.z); }
  return vec4f(s, rest);
}
#include "gsplatUncompressedSHVS"
`;function Lt(e,n,t,o={}){let c=P(e,o),i=k("playcanvas",c),a=W(e,"playcanvas",c),s=i.map(({name:u,width:A,bytes:x})=>({name:u,format:x===2?n.PIXELFORMAT_RGBA16F:A===1?n.PIXELFORMAT_R32U:n.PIXELFORMAT_RGBA32U})),f=new n.GSplatFormat(t,s,{readGLSL:nt,readWGSL:ot}),r=new n.GSplatContainer(t,Math.max(1,e.info.splats),f);r.configureMaterialDefines=u=>u.set("SH_BANDS",String(c)),r.gsplatData.shBands=c;let{box:l}=e.info,[h,p]=[[0,1,2].map(u=>(l[u]+l[u+3])/2),[0,1,2].map(u=>(l[u+3]-l[u])/2)];r.aabb.center.set(h[0],h[1],h[2]),r.aabb.halfExtents.set(p[0],p[1],p[2]),r.update(0);let v=a[1],$=new Float32Array(v.buffer,v.byteOffset,v.length),j=u=>{i.forEach(({name:x},d)=>{let L=r.getTexture(x);L.lock().set(a[d]),L.unlock()});let{centers:A}=r;for(let x=0;x<u;x++)for(let d=0;d<3;d++)A[3*x+d]=$[4*x+d];r.update(u,!0)},_=q(o.signal),K=N(e,"playcanvas",{arrays:a,upload:j},o,_.signal);return{resource:r,rotation:I(e.info.axes),position:J(e,o),done:K,dispose(){_.abort(),r.destroy()}}}export{_t as drawBySpec,Lt as streamToPlayCanvas};
